// Paths inside a store: no name of a stranger's file may lead out of it.

import { demand } from "./refused.js";

const UNSAFE_PART = new Set(["", ".", ".."]);

/** Return a path of a store, after a check that it is relative and stays inside. */
export function safePath(path: string, where: string): string {
  const isSafe =
    /^[\x20-\x7e\u00a0-\uffff]+$/.test(path) &&
    !path.includes("\\") &&
    !/^[A-Za-z]:/.test(path) &&
    !path.split("/").some((part) => UNSAFE_PART.has(part));
  demand(isSafe, `${where}: unsafe path ${JSON.stringify(path)}`);
  return path;
}
