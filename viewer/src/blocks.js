// Reads the blocks of text that pipeline/viewer/packing.py writes.

/** Bytes of an element's text: base64, zlib. */
export async function readBlock(name) {
  const element = document.getElementById(name);
  const text = atob(element.textContent);
  const packed = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) packed[i] = text.charCodeAt(i);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** A table of columns of 16 bits, row by row, from differences down each column. */
export function tableFrom(bytes, count, columns = 8) {
  const table = new Uint16Array(columns * count);
  for (let column = 0; column < columns; column++) {
    const low = column * count;
    const high = (columns + column) * count;
    let value = 0;
    for (let i = 0; i < count; i++) {
      value = (value + bytes[low + i] + 256 * bytes[high + i]) & 65535;
      table[columns * i + column] = value;
    }
  }
  return table;
}

/** 32-bit words of bytes. */
export function wordsFrom(bytes) {
  return new Uint32Array(bytes.buffer, bytes.byteOffset, bytes.byteLength >> 2);
}

/** The nine texels at and around each, from differences down each of nine columns. */
export function adjoiningFrom(differences, count) {
  const adjoining = new Uint32Array(differences.length);
  for (let k = 0; k < 9; k++) {
    let value = 0;
    for (let i = 0; i < count; i++) adjoining[9 * i + k] = value = (value + differences[k * count + i]) >>> 0;
  }
  return adjoining;
}

/** First place of each list in the lists one after the other, and their end. */
export function startsFrom(counts) {
  const starts = new Uint32Array(counts.length + 1);
  for (let i = 0; i < counts.length; i++) starts[i + 1] = starts[i] + counts[i];
  return starts;
}
