// Where the files of an episode are: a folder, or one zip of stored members.

import { open, readdir, readFile, stat, type FileHandle } from "node:fs/promises";
import { join } from "node:path";

import type { AbsolutePath, AsyncReadable } from "@zarrita/storage";
import FileSystemStore from "@zarrita/storage/fs";
import ZipFileStore from "@zarrita/storage/zip";

import { Refused } from "./refused.js";

export type Files = Required<Pick<AsyncReadable, "get" | "getRange">>;

/** Reads at offsets of a file, for the zip. */
class FileReader {
  constructor(
    private readonly handle: FileHandle,
    private readonly size: number,
  ) {}

  async getLength(): Promise<number> {
    return this.size;
  }

  async read(offset: number, length: number): Promise<Uint8Array<ArrayBuffer>> {
    const buffer = new Uint8Array(length);
    const { bytesRead } = await this.handle.read(buffer, 0, length, offset);
    if (bytesRead !== length) throw new Refused("the zip is cut short");
    return buffer;
  }
}

/** Open an episode's folder or zip, use it, and close it again. */
export async function withFiles<T>(path: string, use: (files: Files) => Promise<T>): Promise<T> {
  const found = await stat(path).catch(() => undefined);
  if (!found) throw new Refused(`${path}: no such file or folder`);
  if (found.isDirectory()) return use(new FileSystemStore(path));
  const handle = await open(path, "r");
  try {
    return await use(new ZipFileStore(new FileReader(handle, found.size)));
  } finally {
    await handle.close();
  }
}

/** Read a JSON object of an episode, or give undefined where there is no such file. */
export async function readDocument(files: Files, path: AbsolutePath): Promise<unknown> {
  const raw = await files.get(path);
  return raw === undefined ? undefined : parse(raw, path);
}

/** Read a JSON file of a dataset. */
export async function readJson(path: string): Promise<unknown> {
  const raw = await readFile(path).catch(() => undefined);
  if (raw === undefined) throw new Refused(`${path}: no such file`);
  return parse(raw, path);
}

function parse(raw: Uint8Array, where: string): unknown {
  try {
    return JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(raw));
  } catch (error) {
    throw new Refused(`${where}: not valid JSON (${(error as Error).message})`);
  }
}

/** List the episodes of a dataset; names that begin with a dot are none. */
export async function listEpisodes(root: string): Promise<string[]> {
  const folder = join(root, "episodes");
  const found: string[] = [];
  for (const group of await namesIn(folder)) {
    for (const name of await namesIn(join(folder, group))) {
      if (/\.zarr(\.zip)?$/.test(name)) found.push(join(folder, group, name));
    }
  }
  return found;
}

async function namesIn(folder: string): Promise<string[]> {
  const names = await readdir(folder).catch(() => [] as string[]);
  return names.filter((name) => !name.startsWith(".")).sort();
}
