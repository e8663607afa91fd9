import { brotliCompressSync, constants, gzipSync } from 'node:zlib';
import { readdirSync, readFileSync, writeFileSync } from 'node:fs';
import { join, resolve } from 'node:path';
import { svelte } from '@sveltejs/vite-plugin-svelte';
import { VERSION } from 'svelte/compiler';
import { defineConfig, loadEnv, type Plugin } from 'vite';

const PAGE = resolve(import.meta.dirname, '../ua_fleet/console/page');

/** Beside each file of text its `.br` and `.gz`, so that the console compresses nothing. */
function compressed(): Plugin {
  return {
    name: 'compressed',
    apply: 'build',
    closeBundle() {
      for (const entry of readdirSync(PAGE, { recursive: true, withFileTypes: true })) {
        if (!entry.isFile() || !/\.(html|js|css|svg|json)$/.test(entry.name)) continue;
        const path = join(entry.parentPath, entry.name);
        const bytes = readFileSync(path);
        if (bytes.length < 1024) continue;
        writeFileSync(`${path}.gz`, gzipSync(bytes, { level: 9 }));
        const quality = { [constants.BROTLI_PARAM_QUALITY]: 9, [constants.BROTLI_PARAM_SIZE_HINT]: bytes.length };
        writeFileSync(`${path}.br`, brotliCompressSync(bytes, { params: quality }));
      }
    },
  };
}

/** The version of Svelte that `withoutLeak` is for. */
const LEAKING = '5.57.3';

/**
 * Svelte keeps what is written while a component is taken away, as `bind:this` writes null, in a list that it never
 * empties, and by it the whole component with its elements: half a megabyte for each visit of the robots.
 * Such a write is none of a reaction that runs, of which alone the list is. docs/adr/0064 says when this can go.
 */
function withoutLeak(): Plugin {
  const before = /active_effect !== null &&\n\t*\(active_effect\.f & CLEAN\) !== 0/;
  return {
    name: 'without-leak',
    transform(code, id) {
      if (!id.split('?')[0]?.endsWith('svelte/src/internal/client/reactivity/sources.js')) return;
      if (VERSION !== LEAKING || !before.test(code))
        throw new Error(`svelte ${VERSION} is not the ${LEAKING} that withoutLeak is for (docs/adr/0064)`);
      return { code: code.replace(before, (found) => `active_reaction !== null && ${found}`), map: null };
    },
  };
}

export default defineConfig(({ mode }) => {
  // `npm run dev` shows the sources as they are, with the data of a console that runs: CONSOLE=http://127.0.0.1:8080
  const { CONSOLE = 'http://127.0.0.1:8080' } = { ...loadEnv(mode, '.', 'CONSOLE'), ...process.env };
  return {
    // Relative addresses: the page works below any path of a reverse proxy.
    base: './',
    plugins: [withoutLeak(), svelte(), compressed()],
    build: {
      outDir: PAGE,
      emptyOutDir: true,
      target: 'es2022',
      // An asset within a file would be a `data:` address, which the page's CSP refuses.
      assetsInlineLimit: 0,
      modulePreload: { polyfill: false },
      reportCompressedSize: false,
      manifest: true,
    },
    server: {
      host: '127.0.0.1',
      proxy: {
        '/api': {
          target: CONSOLE,
          ws: true,
          changeOrigin: true,
          // The console compares Origin with its own address.
          headers: { Origin: new URL(CONSOLE).origin },
          rewriteWsOrigin: true,
        },
      },
    },
    // What is tried at random takes long on a busy machine. No file of tests changes what another one sees: a process
    // for each would compute half of all in getting ready.
    test: { include: ['src/**/*.test.ts'], environment: 'node', testTimeout: 30_000, isolate: false },
  };
});
