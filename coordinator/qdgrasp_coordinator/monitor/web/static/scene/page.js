// A page of voxels as the server packs it: little-endian, as every machine that runs a browser is.

const MARK = 0x31474451; // "QDG1"
const HEADER = 24; // bytes

/** What is in a page: `n` voxels with their journal numbers, cells (three each) and outcomes; `next` to ask from. */
export function readPage(buffer) {
  const [mark, n, next, rows, total, origin] = buffer.byteLength < HEADER ? [] : new Uint32Array(buffer, 0, 6);
  if (mark !== MARK || buffer.byteLength !== HEADER + 11 * n) throw new Error("What came is not a page of voxels.");
  return {
    n, next, rows, total, origin,
    numbers: new Uint32Array(buffer, HEADER, n),
    cells: new Int16Array(buffer, HEADER + 4 * n, 3 * n),
    outcomes: new Uint8Array(buffer, HEADER + 10 * n, n),
  };
}
