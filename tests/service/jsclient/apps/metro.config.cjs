// What React Native's own configuration says of modules, without React Native.
const { realpathSync } = require("node:fs");
const { dirname } = require("node:path");

module.exports = {
  watchFolders: [realpathSync(dirname(require.resolve("metro-runtime/package.json")))],
  resolver: { unstable_conditionNames: ["react-native"], unstable_enablePackageExports: true },
  transformer: { babelTransformerPath: require.resolve("@react-native/metro-babel-transformer") },
  reporter: { update() {} },
};
