// Two pages: the live page (index.html, served at /) and the phone's camera page (phone.html, served at /phone).
// The result is committed in server/roomlight_server/page, so that the server needs no Node.

import { readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { defineConfig } from "vite";

const path = (relative: string) => fileURLToPath(new URL(relative, import.meta.url));

/** The licences of what the assets contain; minification removes their comments. */
const licences = {
  name: "licences",
  generateBundle(this: { emitFile: (file: { type: "asset"; fileName: string; source: string }) => string }) {
    const files = ["three/LICENSE", "meshoptimizer/LICENSE.md"];
    const texts = files.map((file) => `${file.split("/")[0]}\n\n${readFileSync(path(`node_modules/${file}`), "utf8").trim()}\n`);
    this.emitFile({ type: "asset", fileName: "assets/THIRD-PARTY.txt", source: texts.join("\n\n") });
  },
};

export default defineConfig({
  base: "/",
  plugins: [licences],
  resolve: {
    dedupe: ["three"], // our client in ../js has a copy of its own for its tests
    alias: [
      { find: /^roomlight$/, replacement: path("../js/src/index.ts") },
      { find: /^roomlight\/(.+)$/, replacement: path("../js/src") + "/$1.ts" },
    ],
  },
  server: { proxy: { "/v1": { target: process.env["ROOMLIGHT_SERVER"] ?? "http://127.0.0.1:8090", ws: true } } },
  build: {
    target: "es2022",
    outDir: process.env["PAGE_OUT"] ?? path("../../server/roomlight_server/page"),
    emptyOutDir: true,
    assetsDir: "assets",
    assetsInlineLimit: 0, // the server's Content-Security-Policy allows no inline scripts or styles
    sourcemap: false,
    modulePreload: { polyfill: false },
    rollupOptions: {
      // three.js in two files of its own: they stay in the browser's cache when the page changes.
      output: { manualChunks: (id) => (id.includes("/three/build/") ? `three-${id.includes("three.core") ? "core" : "renderer"}` : null) },
      input: { index: path("index.html"), phone: path("phone.html") },
    },
  },
});
