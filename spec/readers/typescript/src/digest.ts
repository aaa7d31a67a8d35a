// The digest of an episode: the same for a folder and for its packed form.

import { createHash } from "node:crypto";

import type { Files } from "./files.js";
import { demand } from "./refused.js";

/** Return the SHA-256 over the files outside `derived/`, as section 14 of the standard says. */
export async function digestOf(files: Files): Promise<string> {
  const paths = [...files.sizes.keys()].filter((path) => !path.startsWith("derived/"));
  paths.sort((a, b) => Buffer.compare(Buffer.from(a), Buffer.from(b)));
  const lines = createHash("sha256");
  for (const path of paths) {
    const content = await files.get(`/${path}`);
    demand(content !== undefined, `${path}: the file is gone`);
    const checksum = createHash("sha256").update(content).digest("hex");
    lines.update(`${checksum} ${content.length} ${path}\n`);
  }
  return lines.digest("hex");
}
