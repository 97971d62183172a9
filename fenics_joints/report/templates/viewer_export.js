// Moving pictures of a view: GIF by Lempel and Ziv's method, in the 256 most used colours.

/** Colours of frames of RGBA as a palette, and what gives each pixel its place in it. */
function palette(frames) {
  const count = new Map(), key = (d, i) => (d[i] >> 3) << 10 | (d[i + 1] >> 3) << 5 | d[i + 2] >> 3;
  for (const { data } of frames) {
    for (let i = 0; i < data.length; i += 4) {
      const k = key(data, i);
      count.set(k, (count.get(k) || 0) + 1);
    }
  }
  const most = [...count].sort((a, b) => b[1] - a[1]).slice(0, 256).map(([k]) => k);
  const colours = most.map(k => [k >> 10, k >> 5 & 31, k & 31].map(c => c << 3 | c >> 2));
  const places = new Map(most.map((k, i) => [k, i]));
  const nearest = k => {
    const c = [k >> 10, k >> 5 & 31, k & 31].map(x => x << 3 | x >> 2);
    let best = 0, least = Infinity;
    colours.forEach((o, i) => {
      const off = (o[0] - c[0]) ** 2 + (o[1] - c[1]) ** 2 + (o[2] - c[2]) ** 2;
      if (off < least) { least = off; best = i; }
    });
    places.set(k, best);
    return best;
  };
  return { colours, place: (data, i) => { const k = key(data, i); return places.get(k) ?? nearest(k); } };
}

/** Bytes of codes of 9 to 12 bits for pixels of 8 bits. */
function packed(pixels) {
  const out = [8], block = [];
  let bits = 0, held = 0, size = 9, next = 258, table = new Map();
  const flush = () => { out.push(block.length, ...block); block.length = 0; };
  const byte = b => { block.push(b); if (block.length === 255) flush(); };
  const put = code => {
    bits |= code << held;
    held += size;
    while (held >= 8) { byte(bits & 255); bits >>>= 8; held -= 8; }
  };
  put(256);
  let prefix = pixels[0];
  for (let i = 1; i < pixels.length; i++) {
    const key = prefix << 8 | pixels[i], known = table.get(key);
    if (known !== undefined) { prefix = known; continue; }
    put(prefix);
    if (next === 4096) {
      put(256);
      size = 9; next = 258; table = new Map();
    } else {
      if (next === 1 << size) size++;
      table.set(key, next++);
    }
    prefix = pixels[i];
  }
  put(prefix);
  put(257);
  if (held > 0) byte(bits & 255);
  if (block.length) flush();
  return [...out, 0];
}

/** Frames, each an ImageData of one size, as a GIF that is repeated for ever. */
function gif(frames, hundredths) {
  const { width, height } = frames[0], { colours, place } = palette(frames);
  const short = n => [n & 255, n >> 8];
  const parts = [[..."GIF89a"].map(c => c.charCodeAt(0)), short(width), short(height), [0xf7, 0, 0],
    Array.from({ length: 256 }, (_, i) => colours[i] || [0, 0, 0]).flat(),
    [0x21, 0xff, 11, ...[..."NETSCAPE2.0"].map(c => c.charCodeAt(0)), 3, 1, 0, 0, 0]];
  for (const { data } of frames) {
    const pixels = new Uint8Array(width * height);
    for (let i = 0; i < pixels.length; i++) pixels[i] = place(data, 4 * i);
    parts.push([0x21, 0xf9, 4, 4, ...short(hundredths), 0, 0],
      [0x2c, 0, 0, 0, 0, ...short(width), ...short(height), 0], packed(pixels));
  }
  return new Blob([...parts.map(p => Uint8Array.from(p)), Uint8Array.of(0x3b)], { type: "image/gif" });
}
