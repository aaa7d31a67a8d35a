// Arrays through zarrita, in bounded blocks.

import { createHash } from "node:crypto";

import * as zarr from "zarrita";

import { refuseWrongLengths } from "./codecs.js";
import { readDocument, type Files } from "./files.js";
import { safePath } from "./paths.js";
import { demand, Refused } from "./refused.js";
import { checkShards } from "./shards.js";

const BLOCK_BYTES = 16 * 1024 * 1024;

refuseWrongLengths();

export type Values = zarr.Array<zarr.DataType, Files>;

export interface ArrayDump {
  dtype: string;
  shape: number[];
  sha256: string;
}

/** Open an array, and see that all its shards and chunks are there. */
export async function openArray(files: Files, path: string): Promise<Values> {
  safePath(path, "zarr.json");
  const document = await readDocument(files, `/${path}/zarr.json`);
  demand(document !== undefined, `${path}: the array is missing`);
  await checkShards(files, path, document);
  return zarr.open.v3(zarr.root(files).resolve(path), { kind: "array" });
}

/** Return rows [start, stop) as little-endian bytes. */
export async function rows(array: Values, start: number, stop: number): Promise<Uint8Array> {
  if (start >= stop) return new Uint8Array(0);
  const others = array.shape.slice(1).map(() => null);
  const data = await values(array, [zarr.slice(start, stop), ...others]);
  const { buffer, byteOffset, byteLength } = data as unknown as Uint8Array;
  return new Uint8Array(buffer, byteOffset, byteLength);
}

/** Return a whole array of unsigned 64-bit or 32-bit numbers. */
export async function numbers(array: Values): Promise<number[]> {
  if (array.shape[0] === 0) return []; // zarrita does not read what is empty
  const data = await values(array, null);
  return Array.from(data as unknown as ArrayLike<number | bigint>, Number);
}

async function values(array: Values, selection: Parameters<typeof zarr.get>[1]): Promise<unknown> {
  try {
    return (await zarr.get(array, selection)).data;
  } catch (error) {
    // What is wrong with a chunk is the cause of an error that says only which codec found it.
    const { cause, message } = error as Error;
    throw new Refused(`${array.path.slice(1)}: ${cause instanceof Error ? cause.message : message}`);
  }
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
