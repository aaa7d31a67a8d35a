// A JPEG file, decoded, and the means of its blocks.

import jpeg from "jpeg-js";

import { Refused } from "./refused.js";

const BLOCKS = 4;
const BLOCK_SIDE = 8;
const SOF = new Set([0xc0, 0xc1, 0xc2]);

export interface Picture {
  height: number;
  width: number;
  channels: number;
  blocks: number[][];
}

/** Decode a JPEG file of one or three channels. */
export function decode(file: Uint8Array): Picture {
  const channels = channelsOf(file);
  try {
    const { height, width, data } = jpeg.decode(file, { useTArray: true, formatAsRGBA: true });
    return { height, width, channels, blocks: blockMeans(data, height, width, channels) };
  } catch (error) {
    throw new Refused(`the JPEG is damaged (${(error as Error).message})`);
  }
}

function channelsOf(file: Uint8Array): number {
  let position = 2;
  while (position + 9 < file.length && file[position] === 0xff) {
    if (SOF.has(file[position + 1] ?? 0)) return file[position + 9] ?? 0;
    position += 2 + (file[position + 2] ?? 0) * 256 + (file[position + 3] ?? 0);
  }
  throw new Refused("not a JPEG");
}

/** Mean of each channel in up to 4 by 4 blocks, row by row, from RGBA pixels. */
function blockMeans(rgba: Uint8Array, height: number, width: number, channels: number): number[][] {
  const down = edges(height);
  const across = edges(width);
  const means: number[][] = [];
  for (const [top, bottom] of down) {
    for (const [left, right] of across) {
      const sums = new Array<number>(channels).fill(0);
      for (let y = top; y < bottom; y += 1) {
        for (let x = left; x < right; x += 1) {
          const at = (y * width + x) * 4;
          for (let c = 0; c < channels; c += 1) sums[c] = (sums[c] ?? 0) + (rgba[at + c] ?? 0);
        }
      }
      const count = (bottom - top) * (right - left);
      means.push(sums.map((sum) => Math.round(sum / count)));
    }
  }
  return means;
}

function edges(length: number): [number, number][] {
  const count = Math.max(1, Math.min(BLOCKS, Math.floor(length / BLOCK_SIDE)));
  const at = (k: number) => Math.floor((k * length) / count);
  return Array.from({ length: count }, (_, k) => [at(k), at(k + 1)]);
}
