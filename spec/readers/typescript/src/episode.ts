// The canonical dump of one episode.

import { dumpArray, openArray, type ArrayDump } from "./arrays.js";
import { parseDerived, parseEpisode, type Stream } from "./documents.js";
import { digestOf } from "./digest.js";
import { readDocument, withFiles, type Files } from "./files.js";
import { dumpImages, type ImagesDump } from "./frames.js";
import { demand } from "./refused.js";

interface StreamDump {
  name: string;
  kind: string;
  count: number;
  arrays: ({ name: string } & ArrayDump)[];
  images?: ImagesDump;
}

export interface EpisodeDump {
  dump: 1;
  format: "exumi-episode";
  version: string;
  id: string;
  digest: string;
  streams: StreamDump[];
  arrays: ({ path: string } & ArrayDump)[];
}

export async function dumpEpisode(path: string): Promise<EpisodeDump> {
  return withFiles(path, async (files) => {
    const root = await readDocument(files, "/zarr.json");
    demand(root !== undefined, `${path}: no zarr.json: not an exUMI Episode`);
    const episode = parseEpisode(root);
    const derived = await readDocument(files, "/derived/zarr.json");
    const keys = derived === undefined ? [] : parseDerived(derived);
    const others = [...episode.calibration, ...keys.map((key) => `derived/${key}`)].sort();
    const streams: StreamDump[] = [];
    for (const stream of episode.streams) streams.push(await dumpStream(files, stream));
    const arrays = [];
    for (const name of others) {
      arrays.push({ path: name, ...(await dumpArray(await openArray(files, name))) });
    }
    const { version, id } = episode;
    const digest = await digestOf(files);
    return { dump: 1, format: "exumi-episode", version, id, digest, streams, arrays };
  });
}

async function dumpStream(files: Files, stream: Stream): Promise<StreamDump> {
  const arrays = [];
  for (const name of [...stream.arrays].sort()) {
    const array = await openArray(files, `streams/${stream.name}/${name}`);
    arrays.push({ name, ...(await dumpArray(array)) });
  }
  const count = arrays.find(({ name }) => name === "time")?.shape[0];
  demand(count !== undefined, `stream ${stream.name} has no time`);
  const images = await dumpImages(files, stream, count);
  const { name, kind } = stream;
  return { name, kind, count, arrays, ...(images === undefined ? {} : { images }) };
}
