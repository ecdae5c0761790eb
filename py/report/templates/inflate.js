/* Raw deflate (RFC 1951), unpacked at once: what is drawn before printing cannot wait for a stream. */
function inflate(source, size) {
  "use strict";
  const out = new Uint8Array(size);
  let at = 0, filled = 0, held = 0, bits = 0;

  function take(count) {
    while (bits < count) { held |= source[at++] << bits; bits += 8; }
    const value = held & ((1 << count) - 1);
    held >>>= count;
    bits -= count;
    return value;
  }

  /* Every bit pattern as long as the longest code -> symbol << 4 | length of its code. */
  function codes(lengths) {
    const count = new Uint16Array(16), next = new Uint16Array(16);
    lengths.forEach(function (length) { if (length) count[length]++; });
    let longest = 15;
    while (longest > 1 && !count[longest]) longest--;
    for (let k = 1; k < 16; k++) next[k] = (next[k - 1] + count[k - 1]) << 1;
    const table = new Uint16Array(1 << longest);
    lengths.forEach(function (length, symbol) {
      if (!length) return;
      let code = next[length]++, turned = 0;
      for (let k = 0; k < length; k++) { turned = turned << 1 | code & 1; code >>= 1; }
      for (let k = turned; k < table.length; k += 1 << length) table[k] = symbol << 4 | length;
    });
    return table;
  }

  function symbol(table) {
    while (bits < 15) { held |= source[at++] << bits; bits += 8; }
    const found = table[held & (table.length - 1)];
    held >>>= found & 15;
    bits -= found & 15;
    return found >>> 4;
  }

  function bases(first, extras) {
    let base = first;
    return extras.map(function (extra) { const own = base; base += 1 << extra; return own; });
  }

  const lengthExtra = Array.from({ length: 28 }, function (_, k) { return k < 8 ? 0 : (k >> 2) - 1; });
  const lengthBase = bases(3, lengthExtra).concat(258);
  lengthExtra.push(0);
  const distanceExtra = Array.from({ length: 30 }, function (_, k) { return k < 2 ? 0 : (k >> 1) - 1; });
  const distanceBase = bases(1, distanceExtra);

  function stored() {
    take(bits & 7);
    const count = take(16);
    take(16);
    for (let k = 0; k < count; k++) out[filled++] = take(8);
  }

  function fixed() {
    const lengths = Array.from({ length: 288 }, function (_, k) { return k < 144 ? 8 : k < 256 ? 9 : k < 280 ? 7 : 8; });
    return [codes(lengths), codes(new Array(30).fill(5))];
  }

  function dynamic() {
    const literals = take(5) + 257, distances = take(5) + 1, told = take(4) + 4, own = new Array(19).fill(0), lengths = [];
    for (let k = 0; k < told; k++) own[[16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15][k]] = take(3);
    const table = codes(own);
    while (lengths.length < literals + distances) {
      const kind = symbol(table);
      const value = kind < 16 ? kind : kind === 16 ? lengths[lengths.length - 1] : 0;
      let times = kind < 16 ? 1 : kind === 16 ? 3 + take(2) : kind === 17 ? 3 + take(3) : 11 + take(7);
      while (times--) lengths.push(value);
    }
    return [codes(lengths.slice(0, literals)), codes(lengths.slice(literals))];
  }

  function block(literal, distance) {
    for (;;) {
      const kind = symbol(literal);
      if (kind === 256) return;
      if (kind < 256) { out[filled++] = kind; continue; }
      let left = lengthBase[kind - 257] + take(lengthExtra[kind - 257]);
      const far = symbol(distance);
      let from = filled - distanceBase[far] - take(distanceExtra[far]);
      while (left--) out[filled++] = out[from++];
    }
  }

  for (let last = 0; !last;) {
    last = take(1);
    const kind = take(2);
    if (kind === 0) stored();
    else block.apply(null, kind === 1 ? fixed() : dynamic());
    if (at > source.length + 4) throw new Error("the packed text ends too early");
  }
  return out;
}

/* The text that a <script> element holds packed: base64 of raw deflate of UTF-8, data-size bytes long. */
function unpacked(element) {
  "use strict";
  const text = atob(element.textContent.trim()), bytes = new Uint8Array(text.length);
  for (let k = 0; k < bytes.length; k++) bytes[k] = text.charCodeAt(k);
  return new TextDecoder().decode(inflate(bytes, Number(element.dataset.size)));
}
