// Inflation of a zlib stream (RFC 1950, 1951), at once: browsers inflate only in turns, and a picture of the page would come too early.

/// A table of a code's lengths, by the next 15 bits: `symbol << 4 | length`.
function huffmanTable(lengths) {
  const count = new Uint16Array(16), next = new Uint16Array(16);
  for (const length of lengths) count[length]++;
  count[0] = 0;
  for (let bits = 1, code = 0; bits < 16; bits++) next[bits] = code = (code + count[bits - 1]) << 1;
  const table = new Uint16Array(1 << 15);
  lengths.forEach((length, symbol) => {
    if (!length) return;
    let code = next[length]++, reversed = 0;
    for (let k = 0; k < length; k++) { reversed = (reversed << 1) | (code & 1); code >>= 1; }
    for (let at = reversed; at < 1 << 15; at += 1 << length) table[at] = (symbol << 4) | length;
  });
  return table;
}

const LENGTH_BASE = [3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 15, 17, 19, 23, 27, 31, 35, 43, 51, 59, 67, 83, 99, 115, 131, 163, 195, 227, 258];
const LENGTH_BITS = [0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 0];
const DISTANCE_BASE = [1, 2, 3, 4, 5, 7, 9, 13, 17, 25, 33, 49, 65, 97, 129, 193, 257, 385, 513, 769, 1025, 1537, 2049, 3073, 4097, 6145, 8193, 12289, 16385, 24577];
const CODE_ORDER = [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];

/// `size` bytes of a zlib stream.
function inflate(bytes, size) {
  const out = new Uint8Array(size);
  let at = 2, bits = 0, have = 0, to = 0;
  const need = (n) => { while (have < n) { bits |= (bytes[at++] ?? 0) << have; have += 8; } };
  const take = (n) => { need(n); const value = bits & ((1 << n) - 1); bits >>>= n; have -= n; return value; };
  const symbol = (table) => {
    need(15);
    const entry = table[bits & 32767], length = entry & 15;
    if (!length) throw new Error("its data are damaged");
    bits >>>= length;
    have -= length;
    return entry >> 4;
  };
  for (let last = 0; !last; ) {
    last = take(1);
    const kind = take(2);
    if (kind === 0) {
      // What was read ahead belongs to the block.
      at -= have >> 3;
      bits = have = 0;
      const length = bytes[at] | (bytes[at + 1] << 8);
      out.set(bytes.subarray(at + 4, at + 4 + length), to);
      at += 4 + length;
      to += length;
      continue;
    }
    let literals, distances;
    if (kind === 1) {
      literals = huffmanTable(Array.from({ length: 288 }, (_, i) => (i < 144 ? 8 : i < 256 ? 9 : i < 280 ? 7 : 8)));
      distances = huffmanTable(new Array(30).fill(5));
    } else {
      const [nLiterals, nDistances, nCodes] = [take(5) + 257, take(5) + 1, take(4) + 4];
      const codes = new Array(19).fill(0);
      for (let k = 0; k < nCodes; k++) codes[CODE_ORDER[k]] = take(3);
      const table = huffmanTable(codes);
      const lengths = [];
      while (lengths.length < nLiterals + nDistances) {
        const code = symbol(table);
        if (code < 16) lengths.push(code);
        else {
          const value = code === 16 ? lengths[lengths.length - 1] : 0;
          for (let n = code === 16 ? 3 + take(2) : code === 17 ? 3 + take(3) : 11 + take(7); n > 0; n--) lengths.push(value);
        }
      }
      literals = huffmanTable(lengths.slice(0, nLiterals));
      distances = huffmanTable(lengths.slice(nLiterals));
    }
    for (;;) {
      const code = symbol(literals);
      if (code < 256) { out[to++] = code; continue; }
      if (code === 256) break;
      const length = LENGTH_BASE[code - 257] + take(LENGTH_BITS[code - 257]);
      const far = symbol(distances);
      const distance = DISTANCE_BASE[far] + take(far < 4 ? 0 : (far >> 1) - 1);
      for (const end = to + length; to < end; to++) out[to] = out[to - distance];
    }
  }
  if (to !== size) throw new Error("its data are damaged");
  return out;
}
