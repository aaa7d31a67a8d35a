// zarrita takes a chunk of another length for what it is and fills up with zeros, or leaves out what
// is too much. Here the codec that every chunk passes through last looks at the length first.

import { registry } from "zarrita";

import { demand } from "./refused.js";

type Entry = Awaited<ReturnType<NonNullable<ReturnType<typeof registry.get>>>>;
type Decoded = { data: { BYTES_PER_ELEMENT: number } };

/** Make zarrita refuse chunks that are shorter or longer than their shape asks for. */
export function refuseWrongLengths(): void {
  const plain = registry.get("bytes");
  demand(plain !== undefined, "zarrita has no codec `bytes`");
  registry.set("bytes", async () => checked(await plain()));
}

function checked(entry: Entry): Entry {
  return {
    fromConfig(config, meta) {
      const codec = entry.fromConfig(config, meta);
      const decode = codec.decode.bind(codec);
      const items = meta.shape.reduce((all, side) => all * side, 1);
      codec.decode = (bytes: Uint8Array) => {
        const chunk = decode(bytes);
        const expected = items * (chunk as unknown as Decoded).data.BYTES_PER_ELEMENT;
        const found = bytes.byteLength;
        demand(found === expected, `a chunk has ${found} bytes, expected ${expected}`);
        return chunk;
      };
      return codec;
    },
  };
}
