// node dist/main.js STORE: print the canonical dump. 0: printed; 1: refused; 2: wrong usage.

import { stat } from "node:fs/promises";
import { join } from "node:path";

import { dumpDataset } from "./dataset.js";
import { dumpEpisode } from "./episode.js";
import { orNothing } from "./files.js";

async function main(path: string): Promise<number> {
  try {
    const isFolder = (await orNothing(stat(path)))?.isDirectory() ?? false;
    const isDataset = isFolder && (await orNothing(stat(join(path, "dataset.json")))) !== undefined;
    const dump = await (isDataset ? dumpDataset(path) : dumpEpisode(path));
    process.stdout.write(`${JSON.stringify(dump, undefined, 1)}\n`);
    return 0;
  } catch (error) {
    // Damage shows as errors of many kinds, in zarrita and the decoder too. One line says it.
    const message = error instanceof Error ? error.message : String(error);
    process.stderr.write(`refused: ${message.split(/\s+/).join(" ")}\n`);
    return 1;
  }
}

const [path, ...more] = process.argv.slice(2);
if (path === undefined || more.length > 0) {
  process.stderr.write("usage: node dist/main.js STORE\n");
  process.exitCode = 2;
} else {
  process.exitCode = await main(path);
}
