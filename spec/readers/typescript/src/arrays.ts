// Arrays through zarrita, in bounded blocks; a missing shard is damage, never a fill value.

import { createHash } from "node:crypto";

import type { AbsolutePath } from "@zarrita/storage";
import * as zarr from "zarrita";

import { readDocument, type Files } from "./files.js";
import { isObject } from "./documents.js";
import { demand, Refused } from "./refused.js";

const BLOCK_BYTES = 16 * 1024 * 1024;

export type Values = zarr.Array<zarr.DataType, Files>;

export interface ArrayDump {
  dtype: string;
  shape: number[];
  sha256: string;
}

/** Open an array, and see that all its shards are there. */
export async function openArray(files: Files, path: string): Promise<Values> {
  const document = await readDocument(files, `/${path}/zarr.json`);
  demand(document !== undefined, `${path}: the array is missing`);
  const array = await zarr.open.v3(zarr.root(files).resolve(path), { kind: "array" });
  await checkShards(files, path, shardRows(document), array.shape);
  return array;
}

function shardRows(document: unknown): number {
  const grid = isObject(document) ? document["chunk_grid"] : undefined;
  const settings = isObject(grid) ? grid["configuration"] : undefined;
  const shape = isObject(settings) ? settings["chunk_shape"] : undefined;
  const rows: unknown = Array.isArray(shape) ? shape[0] : undefined;
  if (typeof rows !== "number" || rows < 1) throw new Refused("no regular chunk grid");
  return rows;
}

async function checkShards(
  files: Files,
  path: string,
  rows: number,
  shape: number[],
): Promise<void> {
  const tail = "/0".repeat(shape.length - 1);
  for (let shard = 0; shard * rows < (shape[0] ?? 0); shard += 1) {
    const key: AbsolutePath = `/${path}/c/${shard}${tail}`;
    const end = await files.getRange(key, { suffixLength: 4 });
    demand(end !== undefined, `${path}: shard ${shard} is missing`);
  }
}

/** Return rows [start, stop) as little-endian bytes. */
export async function rows(array: Values, start: number, stop: number): Promise<Uint8Array> {
  if (start >= stop) return new Uint8Array(0);
  const others = array.shape.slice(1).map(() => null);
  const { data } = await zarr.get(array, [zarr.slice(start, stop), ...others]);
  const { buffer, byteOffset, byteLength } = data as unknown as Uint8Array;
  return new Uint8Array(buffer, byteOffset, byteLength);
}

/** Return a whole array of unsigned 64-bit or 32-bit numbers. */
export async function numbers(array: Values): Promise<number[]> {
  if (array.shape[0] === 0) return []; // zarrita does not read what is empty
  const { data } = await zarr.get(array);
  return Array.from(data as unknown as ArrayLike<number | bigint>, Number);
}

/** Return what the dump says of an array. */
export async function dumpArray(array: Values): Promise<ArrayDump> {
  const count = array.shape[0] ?? 0;
  const rowBytes = 8 * array.shape.slice(1).reduce((all, side) => all * side, 1);
  const step = Math.max(1, Math.floor(BLOCK_BYTES / Math.max(1, rowBytes)));
  const hash = createHash("sha256");
  for (let start = 0; start < count; start += step) {
    hash.update(await rows(array, start, Math.min(count, start + step)));
  }
  return { dtype: array.dtype, shape: array.shape, sha256: hash.digest("hex") };
}
