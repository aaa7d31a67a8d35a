// The canonical dump of a dataset: its splits and the dumps of its episodes.

import { join } from "node:path";

import { checkVersion, isObject, text } from "./documents.js";
import { dumpEpisode, type EpisodeDump } from "./episode.js";
import { listEpisodes, readJson } from "./files.js";
import { demand } from "./refused.js";

export interface DatasetDump {
  dump: 1;
  format: "exumi-dataset";
  version: string;
  name: string;
  splits: { name: string; lists: Record<string, string[]> }[];
  episodes: EpisodeDump[];
}

export async function dumpDataset(root: string): Promise<DatasetDump> {
  const where = "dataset.json";
  const document = await readJson(join(root, where));
  demand(isObject(document), `${where}: expected a JSON object`);
  const version = checkVersion(document, "exumi-dataset", where);
  const names = Array.isArray(document["splits"]) ? document["splits"].map(String) : [];
  const splits = [];
  for (const name of [...names].sort()) splits.push(await readSplit(root, name));
  const episodes: EpisodeDump[] = [];
  for (const path of await listEpisodes(root)) episodes.push(await dumpEpisode(path));
  episodes.sort((a, b) => (a.id < b.id ? -1 : 1));
  const name = text(document, "name", where);
  return { dump: 1, format: "exumi-dataset", version, name, splits, episodes };
}

async function readSplit(root: string, name: string): Promise<DatasetDump["splits"][number]> {
  const where = `splits/${name}.json`;
  demand(/^[a-z0-9][a-z0-9_-]*$/.test(name), `${name} is no name of a split`);
  const document = await readJson(join(root, where));
  demand(isObject(document), `${where}: expected a JSON object`);
  checkVersion(document, "exumi-split", where);
  return { name, lists: document["lists"] as Record<string, string[]> };
}
