// The documents: versions first, then the few fields that reading needs.

import { safePath } from "./paths.js";
import { demand, Refused } from "./refused.js";

const MAJOR = 1;
const KNOWN_FEATURES: ReadonlySet<string> = new Set(); // 1.0 defines none

export type Json = Record<string, unknown>;

export interface Images {
  encoding: string;
  height: number;
  width: number;
  channels: number;
  files: { name: string; bytes: number; sha256: string }[];
}

export interface Stream {
  name: string;
  kind: string;
  arrays: string[];
  images: Images | undefined;
}

export interface Episode {
  version: string;
  id: string;
  streams: Stream[];
  calibration: string[];
}

export function isObject(value: unknown): value is Json {
  return typeof value === "object" && value !== null && !Array.isArray(value);
}

/** Return the attribute `exumi` of a group's document. */
export function exumiOf(group: unknown, where: string): Json {
  const attributes = isObject(group) ? group["attributes"] : undefined;
  const document = isObject(attributes) ? attributes["exumi"] : undefined;
  demand(isObject(document), `${where}: no attribute \`exumi\`: not an exUMI Episode`);
  return document;
}

/** Check `format`, `version` and `requires`; return the version. */
export function checkVersion(document: Json, format: string, where: string): string {
  const { format: found, version, requires } = document;
  demand(found === format, `${where}: expected format ${format}, found ${String(found)}`);
  demand(
    typeof version === "string" && /^(0|[1-9]\d{0,8})\.(0|[1-9]\d{0,8})$/.test(version),
    `${where}: version ${String(version)} is not major.minor`,
  );
  demand(
    Number.parseInt(version, 10) === MAJOR,
    `${where}: ${format} version ${version}; this reader reads ${MAJOR}.x. ` +
      `Install a reader of ${version}.`,
  );
  for (const feature of Array.isArray(requires) ? requires : []) {
    demand(
      KNOWN_FEATURES.has(String(feature)),
      `${where}: requires ${String(feature)}, which this reader does not know. ` +
        `Install a reader that does (format version ${version}).`,
    );
  }
  return version;
}

/** Return a field that has to be a string. */
export function text(document: Json, key: string, where: string): string {
  const value = document[key];
  demand(typeof value === "string", `${where}: ${key} is no string`);
  return value;
}

/** Read the root's document. */
export function parseEpisode(group: unknown): Episode {
  const where = "zarr.json";
  const document = exumiOf(group, where);
  const version = checkVersion(document, "exumi-episode", where);
  const streams = document["streams"] ?? {};
  demand(isObject(streams), `${where}: streams is no object`);
  const calibration = isObject(document["calibration"]) ? document["calibration"] : {};
  return {
    version,
    id: text(document, "id", where),
    streams: Object.entries(streams).map(([name, stream]) => parseStream(name, stream)),
    calibration: Object.values(calibration)
      .map((item) => (isObject(item) ? item["array"] : undefined))
      .filter((path) => typeof path === "string")
      .map((path) => calibrationPath(path, where)),
  };
}

function calibrationPath(path: string, where: string): string {
  demand(path.startsWith("calibration/"), `${where}: ${path} is not below calibration/`);
  return safePath(path, where);
}

function parseStream(name: string, stream: unknown): Stream {
  const where = `zarr.json: stream ${name}`;
  demand(/^[a-z][a-z0-9_]*$/.test(name) && isObject(stream), `${where} is none`);
  const arrays = stream["arrays"];
  const isName = (array: unknown) => typeof array === "string" && /^[a-z][a-z0-9_]*$/.test(array);
  demand(Array.isArray(arrays) && arrays.every(isName), `${where}: arrays is no list of names`);
  const images = stream["images"];
  return {
    name,
    kind: text(stream, "kind", where),
    arrays,
    images: images === undefined ? undefined : parseImages(images, where),
  };
}

function parseImages(images: unknown, where: string): Images {
  demand(isObject(images), `${where}: images is no object`);
  const size = (key: string): number => {
    const value = images[key];
    if (typeof value !== "number") throw new Refused(`${where}: images.${key} is no number`);
    return value;
  };
  return {
    encoding: text(images, "encoding", where),
    height: size("height"),
    width: size("width"),
    channels: size("channels"),
    files: (images["files"] as Images["files"] | undefined) ?? [],
  };
}

/** Return the keys `<stream>/<name>` of the derived arrays. */
export function parseDerived(group: unknown): string[] {
  const where = "derived/zarr.json";
  const document = exumiOf(group, where);
  checkVersion(document, "exumi-derived", where);
  const items = document["items"];
  demand(isObject(items), `${where}: items is no object`);
  const keys = Object.keys(items);
  demand(keys.every((key) => /^[a-z][a-z0-9_]*\/[a-z][a-z0-9_]*$/.test(key)), `${where}: bad key`);
  return keys;
}
