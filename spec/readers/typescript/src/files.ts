// Where the files of an episode are: a folder, or one zip of stored members.

import { open, readdir, readFile, stat, type FileHandle } from "node:fs/promises";
import { join } from "node:path";

import type { AbsolutePath, AsyncReadable } from "@zarrita/storage";
import FileSystemStore from "@zarrita/storage/fs";
import ZipFileStore from "@zarrita/storage/zip";

import { safePath } from "./paths.js";
import { demand, Refused } from "./refused.js";

const UNIX = 3;
const FILE_TYPE = 0o170000;
const REGULAR_FILE = 0o100000;

type Readable = Required<Pick<AsyncReadable, "get" | "getRange">>;
type Entry = { size: number; externalFileAttributes: number; versionMadeBy: number };

/** The files of an episode: paths from its root, without a slash in front, and sizes in bytes. */
export interface Files extends Readable {
  readonly sizes: ReadonlyMap<string, number>;
}

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
    demand(offset >= 0 && offset + length <= this.size, "the zip is cut short");
    const buffer = new Uint8Array(length);
    const { bytesRead } = await this.handle.read(buffer, 0, length, offset);
    demand(bytesRead === length, "the zip is cut short");
    return buffer;
  }
}

/** Open an episode's folder or zip, use it, and close it again. */
export async function withFiles<T>(path: string, use: (files: Files) => Promise<T>): Promise<T> {
  const found = await orNothing(stat(path));
  demand(found !== undefined, `${path}: no such file or folder`);
  if (found.isDirectory()) return use(filesOf(new FileSystemStore(path), await folderSizes(path)));
  const handle = await open(path, "r");
  try {
    return await use(await zipFiles(new FileReader(handle, found.size)));
  } finally {
    await handle.close();
  }
}

/** Files that are listed: nothing else is ever asked for. */
function filesOf(store: Readable, sizes: Map<string, number>): Files {
  const isThere = (path: AbsolutePath) => sizes.has(safePath(path.slice(1), "store"));
  return {
    sizes,
    get: async (path) => (isThere(path) ? store.get(path) : undefined),
    getRange: async (path, range) => (isThere(path) ? store.getRange(path, range) : undefined),
  };
}

async function folderSizes(root: string): Promise<Map<string, number>> {
  const sizes = new Map<string, number>();
  const visit = async (folder: string): Promise<void> => {
    for (const entry of await readdir(join(root, folder), { withFileTypes: true })) {
      const path = safePath(folder === "" ? entry.name : `${folder}/${entry.name}`, root);
      if (entry.isDirectory()) {
        await visit(path);
      } else {
        demand(entry.isFile(), `${join(root, path)} is a link or a special file`);
        sizes.set(path, (await stat(join(root, path))).size);
      }
    }
  };
  await visit("");
  return sizes;
}

async function zipFiles(reader: FileReader): Promise<Files> {
  const sizes = new Map<string, number>();
  const transformEntries = <T extends Record<string, Entry>>(entries: T): T => {
    for (const [path, entry] of Object.entries(entries)) {
      safePath(path, "zip");
      demand(!isSpecial(entry), `${path} is a link or a special file`);
      sizes.set(path, entry.size);
    }
    return entries;
  };
  const store = new ZipFileStore(reader, { transformEntries });
  await store.has("/zarr.json"); // the directory is read now
  return filesOf(store, sizes);
}

function isSpecial(entry: Entry): boolean {
  const kind = (entry.externalFileAttributes >>> 16) & FILE_TYPE;
  return entry.versionMadeBy >>> 8 === UNIX && kind !== 0 && kind !== REGULAR_FILE;
}

/** Read a JSON object of an episode, or give undefined where there is no such file. */
export async function readDocument(files: Files, path: AbsolutePath): Promise<unknown> {
  const raw = await files.get(path);
  return raw === undefined ? undefined : parse(raw, path);
}

/** Read a JSON file of a dataset. */
export async function readJson(path: string): Promise<unknown> {
  const raw = await orNothing(readFile(path));
  demand(raw !== undefined, `${path}: no such file`);
  return parse(raw, path);
}

function parse(raw: Uint8Array, where: string): unknown {
  try {
    return JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(raw));
  } catch (error) {
    throw new Refused(`${where}: not valid JSON (${(error as Error).message})`);
  }
}

/** List the episodes of a dataset; names that begin with a dot are none, and no link is. */
export async function listEpisodes(root: string): Promise<string[]> {
  const folder = join(root, "episodes");
  const found: string[] = [];
  for (const group of await entriesIn(folder)) {
    if (!group.isDirectory()) continue;
    for (const entry of await entriesIn(join(folder, group.name))) {
      const isEpisode = entry.isDirectory() ? /\.zarr$/ : /\.zarr\.zip$/;
      if (!entry.isSymbolicLink() && isEpisode.test(entry.name)) {
        found.push(join(folder, group.name, entry.name));
      }
    }
  }
  return found.sort();
}

async function entriesIn(folder: string) {
  const entries = (await orNothing(readdir(folder, { withFileTypes: true }))) ?? [];
  return entries.filter((entry) => !entry.name.startsWith("."));
}

/** Wait for a file or folder; undefined says that it is not there. Every other failure stays one. */
export async function orNothing<T>(pending: Promise<T>): Promise<T | undefined> {
  try {
    return await pending;
  } catch (error) {
    if ((error as NodeJS.ErrnoException).code === "ENOENT") return undefined;
    throw error;
  }
}
