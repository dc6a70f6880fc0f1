// A page of voxels as the server packs it: little-endian, as every machine that runs a browser is.

const MARK = 0x32474451; // "QDG2"
const HEADER = 24; // bytes
const WIDTH = 17; // bytes of each voxel

/** What is in a page: `n` voxels with journal numbers, etas (-1: none), cells (three each), synergies (-1: none) and
 *  outcomes; the serial to ask from `next`, whether there is `more` at once, and the `origin` of all of it. */
export function readPage(buffer) {
  const [mark, n, next, more, total, origin] = buffer.byteLength < HEADER ? [] : new Uint32Array(buffer, 0, 6);
  if (mark !== MARK || buffer.byteLength !== HEADER + WIDTH * n) throw new Error("What came is not a page of voxels.");
  return {
    n, next, more: Boolean(more), total, origin,
    numbers: new Uint32Array(buffer, HEADER, n),
    etas: new Float32Array(buffer, HEADER + 4 * n, n),
    cells: new Int16Array(buffer, HEADER + 8 * n, 3 * n),
    synergies: new Int16Array(buffer, HEADER + 14 * n, n),
    outcomes: new Uint8Array(buffer, HEADER + 16 * n, n),
  };
}
