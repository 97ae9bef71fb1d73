import { defineConfig } from "vitest/config";

/** Three files with names that never change: the server embeds them and tells versions apart by their content. */
export default defineConfig({
  base: "./",
  build: {
    target: "es2022",
    modulePreload: { polyfill: false },
    assetsInlineLimit: 0,
    chunkSizeWarningLimit: 1000,
    rolldownOptions: {
      output: { entryFileNames: "app.js", assetFileNames: "app[extname]", codeSplitting: false },
    },
  },
  server: { proxy: { "/sightline.v1": process.env["SIGHTLINE_ADDRESS"] ?? "http://127.0.0.1:7410" } },
  test: { include: ["tests/*.test.ts", "browser/*.test.ts"], pool: "threads" },
});
