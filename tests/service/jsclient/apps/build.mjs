// Builds the app in this folder: node build.mjs TOOL OUTPUT. Run where the package and the tool are in node_modules.
import { cp } from "node:fs/promises";
import { resolve } from "node:path";

const [tool, output] = process.argv.slice(2);
const here = process.cwd();
const outdir = resolve(output);

const tools = {
  async vite() {
    const { build } = await import("vite");
    const input = resolve("page.html");
    await build({ root: here, base: "./", logLevel: "warn", build: { outDir: outdir, rollupOptions: { input } } });
  },

  async esbuild() {
    const { build } = await import("esbuild");
    await build({ entryPoints: ["page.js"], bundle: true, format: "esm", minify: true, outdir });
    await cp("page.html", `${outdir}/page.html`);
  },

  /** The same, to be served under a policy that forbids what it does. */
  "esbuild-strict": () => tools.esbuild(),

  /** The worker as a file of its own, as the README says. */
  async "esbuild-worker"() {
    const { build } = await import("esbuild");
    await build({
      entryPoints: { page: "page.js", worker: "@mfcmt/client/worker" },
      define: { WORKER_URL: '"worker.js"' },
      bundle: true,
      format: "esm",
      outdir,
    });
    await cp("page.html", `${outdir}/page.html`);
  },

  async react() {
    const { build } = await import("esbuild");
    const define = { "process.env.NODE_ENV": '"development"' };
    await build({ entryPoints: { page: "react.jsx" }, bundle: true, format: "esm", jsx: "automatic", define, outdir });
    await cp("page.html", `${outdir}/page.html`);
  },

  async webpack() {
    const { default: webpack } = await import("webpack");
    const compiler = webpack({ mode: "production", context: here, entry: "./page.js", output: { path: outdir, filename: "page.js" } });
    await new Promise((done, failed) => {
      compiler.run((error, stats) => (error || stats.hasErrors() ? failed(error ?? new Error(stats.toString())) : done()));
    });
    await cp("page.html", `${outdir}/page.html`);
  },

  async metro() {
    const { default: Metro } = await import("metro");
    const defaults = await Metro.loadConfig({ cwd: here, config: resolve("metro.config.cjs") });
    await Metro.runBuild(defaults, { entry: "native.js", out: `${outdir}/native.js`, platform: "android", dev: false, minify: false });
  },
};

await tools[tool]();
