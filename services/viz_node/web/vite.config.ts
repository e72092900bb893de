import { defineConfig } from "vitest/config";

const here = (path: string): string => new URL(path, import.meta.url).pathname;

export default defineConfig({
  base: "./",
  // the tests of panels of packages lie with them
  // A thread for each file is as much apart as a process, and starts sooner. A slow machine may take its time.
  test: { include: ["test/**/*.test.ts", here("../../../packages/*/tests/web/*.test.ts")], pool: "threads", testTimeout: 60_000, server: { deps: { inline: true } } },
  resolve: { alias: { "../../kit.js": here("src/kit.ts"), vitest: here("node_modules/vitest") } },
  build: {
    target: "es2022",
    // the content security policy of the server permits no inline script or style
    modulePreload: { polyfill: false },
    assetsInlineLimit: 0,
    chunkSizeWarningLimit: 1200,
    // one file of styles, which pages of packages have too
    cssCodeSplit: false,
    // the page, and what panels of packages import from it by a name that stays
    rolldownOptions: {
      input: { index: "index.html", kit: "src/kit.ts" },
      preserveEntrySignatures: "strict",
      output: {
        entryFileNames: ({ name }) => (name === "kit" ? "kit.js" : "assets/[name]-[hash].js"),
        assetFileNames: ({ names }) => (names.some((name) => name.endsWith(".css")) ? "kit.css" : "assets/[name]-[hash][extname]"),
      },
    },
  },
});
