// What the dump says of the frames of an image stream.

import { createHash } from "node:crypto";

import { numbers, openArray, rows, type Values } from "./arrays.js";
import { crc32c } from "./crc32c.js";
import type { Stream } from "./documents.js";
import type { Files } from "./files.js";
import { decode, type Picture } from "./pixels.js";
import { demand, Refused } from "./refused.js";

type FrameDump = { index: number; sha256: string } & Partial<Picture>;

export interface ImagesDump {
  encoding: string;
  frames?: FrameDump[];
  files?: { name: string; bytes: number; sha256: string }[];
}

function sha256(data: Uint8Array): string {
  return createHash("sha256").update(data).digest("hex");
}

/** The first, the middle and the last of `count` frames. */
function chosen(count: number): number[] {
  return count === 0 ? [] : [...new Set([0, Math.floor(count / 2), count - 1])];
}

export async function dumpImages(
  files: Files,
  stream: Stream,
  count: number,
): Promise<ImagesDump | undefined> {
  const encoding = stream.images?.encoding;
  if (encoding === undefined) return undefined;
  if (encoding === "array") return { encoding, frames: await pixelFrames(files, stream, count) };
  if (encoding === "encoded") return { encoding, frames: await jpegFrames(files, stream, count) };
  if (encoding === "video") return { encoding, files: await videoFiles(files, stream) };
  throw new Refused(`stream ${stream.name}: unknown encoding ${encoding}`);
}

async function pixelFrames(files: Files, stream: Stream, count: number): Promise<FrameDump[]> {
  const data = await openArray(files, `streams/${stream.name}/data`);
  const found: FrameDump[] = [];
  for (const index of chosen(count)) {
    found.push({ index, sha256: sha256(await rows(data, index, index + 1)) });
  }
  return found;
}

async function jpegFrames(files: Files, stream: Stream, count: number): Promise<FrameDump[]> {
  const base = `streams/${stream.name}`;
  const data = await openArray(files, `${base}/data`);
  const offset = await numbers(await openArray(files, `${base}/offset`));
  const checksums = await numbers(await openArray(files, `${base}/crc32c`));
  const found: FrameDump[] = [];
  const wanted = new Set(chosen(count));
  for (let index = 0; index < count; index += 1) {
    const where = `stream ${stream.name}, frame ${index}`;
    const file = await part(data, offset, index, where);
    demand(crc32c(file) === checksums[index], `${where}: wrong checksum`);
    if (!wanted.has(index)) continue;
    const picture = decode(file);
    const { height, width, channels } = stream.images ?? {};
    demand(
      picture.height === height && picture.width === width && picture.channels === channels,
      `${where}: not of the stated size`,
    );
    found.push({ index, sha256: sha256(file), ...picture });
  }
  return found;
}

async function videoFiles(
  files: Files,
  stream: Stream,
): Promise<{ name: string; bytes: number; sha256: string }[]> {
  const base = `streams/${stream.name}`;
  const data = await openArray(files, `${base}/data`);
  const offset = await numbers(await openArray(files, `${base}/offset`));
  const found = [];
  for (const [index, { name }] of (stream.images?.files ?? []).entries()) {
    const file = await part(data, offset, index, `stream ${stream.name}, file ${index}`);
    found.push({ name, bytes: file.length, sha256: sha256(file) });
  }
  return found;
}

/** Return the bytes of one file among those that lie end to end in `data`. */
async function part(data: Values, offset: number[], index: number, where: string) {
  const [start = -1, stop = -1] = offset.slice(index, index + 2);
  demand(0 <= start && start <= stop && stop <= (data.shape[0] ?? 0), `${where}: not in data`);
  return rows(data, start, stop);
}
