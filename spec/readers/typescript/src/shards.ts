// The shards of an array, checked before zarrita reads them: it takes a missing shard or chunk for
// zeros, and does not look at the checksum of an index.

import type { AbsolutePath } from "@zarrita/storage";

import { crc32c } from "./crc32c.js";
import { isObject, type Json } from "./documents.js";
import type { Files } from "./files.js";
import { demand, Refused } from "./refused.js";

const ENTRY_BYTES = 16;
const CHECKSUM_BYTES = 4;

/** How an array is cut along its first axis; along the others it is not. */
interface Layout {
  count: number;
  chunkRows: number;
  shardRows: number;
  axes: number;
}

/** See that every shard is there, ends in a sound index, and holds every chunk. */
export async function checkShards(files: Files, path: string, document: unknown): Promise<void> {
  const layout = layoutOf(document, path);
  for (let shard = 0; shard * layout.shardRows < layout.count; shard += 1) {
    const name = `${path}/c/${shard}${"/0".repeat(layout.axes - 1)}`;
    const rows = Math.min(layout.shardRows, layout.count - shard * layout.shardRows);
    const places = layout.shardRows / layout.chunkRows;
    await checkShard(files, name, places, Math.ceil(rows / layout.chunkRows));
  }
}

async function checkShard(files: Files, name: string, places: number, stored: number) {
  const size = files.sizes.get(name);
  demand(size !== undefined, `${name}: the shard is missing`);
  const indexBytes = places * ENTRY_BYTES + CHECKSUM_BYTES;
  const end = size - indexBytes;
  demand(end >= 0, `${name}: the shard is cut short`);
  const key: AbsolutePath = `/${name}`;
  const raw = await files.getRange(key, { offset: end, length: indexBytes });
  demand(raw !== undefined && raw.byteLength === indexBytes, `${name}: the shard is cut short`);
  const index = new DataView(raw.buffer, raw.byteOffset, raw.byteLength);
  const entries = raw.subarray(0, places * ENTRY_BYTES);
  const checksum = index.getUint32(entries.length, true);
  demand(crc32c(entries) === checksum, `${name}: the shard's index has a wrong checksum`);
  for (let chunk = 0; chunk < stored; chunk += 1) {
    const offset = index.getBigUint64(chunk * ENTRY_BYTES, true);
    const length = index.getBigUint64(chunk * ENTRY_BYTES + 8, true);
    // An absent chunk has 2^64 - 1 in both.
    demand(offset + length <= BigInt(end), `${name}: chunk ${chunk} is not in the shard`);
  }
}

function layoutOf(document: unknown, path: string): Layout {
  const shape = sides(isObject(document) ? document["shape"] : undefined, path, 0);
  const shard = sides(settings(document, "chunk_grid")["chunk_shape"], path, 1);
  const codecs = isObject(document) ? document["codecs"] : undefined;
  const only: unknown = Array.isArray(codecs) && codecs.length === 1 ? codecs[0] : undefined;
  demand(isObject(only) && only["name"] === "sharding_indexed", `${path}: not stored in shards`);
  const sharding = settings({ only }, "only");
  const chunk = sides(sharding["chunk_shape"], path, 1);
  const isWhole = [shard, chunk].every(
    (other) => other.length === shape.length && other.slice(1).every((n, at) => n === shape[at + 1]),
  );
  const [count = 0, shardRows = 1, chunkRows = 1] = [shape[0], shard[0], chunk[0]];
  demand(isWhole && shardRows % chunkRows === 0, `${path}: cut along another axis than the first`);
  demand(hasPlainIndex(sharding), `${path}: an index without a checksum at the end`);
  return { count, chunkRows, shardRows, axes: shape.length };
}

function hasPlainIndex(sharding: Json): boolean {
  const codecs = sharding["index_codecs"];
  const names = Array.isArray(codecs) ? codecs.map((codec) => isObject(codec) && codec["name"]) : [];
  const location = sharding["index_location"] ?? "end";
  return location === "end" && names.length === 2 && names[0] === "bytes" && names[1] === "crc32c";
}

function settings(owner: unknown, key: string): Json {
  const part = isObject(owner) ? owner[key] : undefined;
  const found = isObject(part) ? part["configuration"] : undefined;
  return isObject(found) ? found : {};
}

function sides(value: unknown, path: string, smallest: number): number[] {
  const isSide = (n: unknown): n is number => Number.isSafeInteger(n) && (n as number) >= smallest;
  if (Array.isArray(value) && value.length > 0 && value.every(isSide)) return value;
  throw new Refused(`${path}: not the shape of an array`);
}
