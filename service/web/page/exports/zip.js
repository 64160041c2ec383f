// Writes zip files.

/** A zip file with `files`, texts by their names; resolves to its bytes. */
export async function zipped(files) {
  const { strToU8, zipSync } = await import("../vendor/fflate/browser.js");
  return zipSync(Object.fromEntries([...files].map(([name, text]) => [name, strToU8(text)])));
}
