import { defineConfig } from "vite";

export default defineConfig({
  base: "./",
  build: {
    target: "es2022",
    // the content security policy of the server permits no inline script or style
    modulePreload: { polyfill: false },
    assetsInlineLimit: 0,
    chunkSizeWarningLimit: 1200,
    // the cockpit, and the page of a participant, who is told nothing of what the cockpit shows
    rolldownOptions: { input: ["index.html", "participant.html"] },
  },
});
