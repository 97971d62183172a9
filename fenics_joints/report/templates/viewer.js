// Draws what report/view.py wrote into the page: faces whose corners move, by WebGL 2.
const TURN = -0.489, TILT = 0.489, SWING = 0.14; // as the pictures are seen; of half the size
const VIEWS = { Oblique: [TURN, TILT], Front: [0, 0], Side: [-Math.PI / 2, 0], Top: [0, Math.PI / 2] };
const FRAMES = 24, WIDEST = 640; // of a moving picture, over a period; pixels

class View {
  constructor(stage, scene) {
    this.scene = scene;
    this.root = stage.querySelector(".view");
    this.canvas = element("canvas", this.root, { tabIndex: 0 });
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `${scene.name} Arrow keys turn it, + and - zoom.`);
    const gl = this.gl = this.canvas.getContext("webgl2", { antialias: true, alpha: true });
    if (!gl) { this.root.replaceChildren(); return; }
    this.points = shorts(scene.points);
    this.levels = scene.levels && new Uint16Array(bytes(scene.levels));
    this.groups = scene.groups && new Uint16Array(bytes(scene.groups));
    const Faces = scene.n < 65536 ? Uint16Array : Uint32Array;
    this.faces = new Faces(bytes(scene.faces));
    this.hidden = new Set();
    this.rest = true;
    this.home();
    this.prepare();
    this.sort();
    this.controls();
    this.choose(0);
    this.listen();
    stage.classList.add("live");
    stage.view = this;
    this.resize();
  }

  // -- WebGL -------------------------------------------------------------------------------

  prepare() {
    const gl = this.gl, program = this.program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, CORNER], [gl.FRAGMENT_SHADER, COLOUR]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    ["position", "motion", "value", "level"].forEach((n, i) => gl.bindAttribLocation(program, i, n));
    gl.linkProgram(program);
    gl.useProgram(program);
    this.at = new Proxy({}, { get: (_, name) => gl.getUniformLocation(program, name) });
    this.buffers = [this.points, null, null, this.levels].map(data => this.buffer(data));
    this.ramp = gl.createTexture();
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  buffer(data, target = this.gl.ARRAY_BUFFER, old = null) {
    if (!data) return null;
    const made = old || this.gl.createBuffer();
    this.gl.bindBuffer(target, made);
    this.gl.bufferData(target, data, this.gl.STATIC_DRAW);
    return made;
  }

  /** Triangles and edges of the parts that are shown. */
  sort() {
    const { faces, scene: { corners }, levels, hidden } = this;
    const shown = hidden.size ? faces.filter((_, i) => !hidden.has(levels[faces[i - i % corners]])) : faces;
    this.lists = split(shown, corners, this.points);
    this.indices = this.lists.map((list, i) =>
      this.buffer(list, this.gl.ELEMENT_ARRAY_BUFFER, this.indices && this.indices[i]));
  }

  attribute(i, buffer, size, kind, whole) {
    const gl = this.gl;
    if (!buffer) {
      gl.disableVertexAttribArray(i);
      gl.vertexAttrib3f(i, i === 2 ? -1 : 0, 0, 0);
      return;
    }
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.enableVertexAttribArray(i);
    gl.vertexAttribPointer(i, size, kind, whole, 0, 0);
  }

  /** Show one of the looks, with one of the test's shapes: by default the one that belongs to it. */
  choose(number, test = this.scene.looks[number].match ?? -1) {
    const gl = this.gl, look = this.look = this.scene.looks[number];
    this.test = look.scales ? test : -1;
    if (this.list) this.list.value = number;
    if (this.testList) this.testList.value = this.test;
    look.moved = look.motion && (look.moved || shorts(look.motion));
    look.shade = look.values && (look.shade || shorts(look.values));
    this.buffers[1] = this.buffer(look.moved);
    this.buffers[2] = this.buffer(look.shade);
    this.shown = [...look.arrows];
    if (this.test >= 0) {
      const measured = this.scene.tests[this.test], scale = look.scales[this.test];
      this.shown.push({ ...measured, vectors: measured.vectors.map(v => scale * v) });
    }
    this.arrows = this.shown.map(a => {
      const shape = arrowShapes(a);
      return { colour: rgb(a.colour), count: shape.position.length / 3,
        position: this.buffer(shape.position), motion: this.buffer(shape.motion) };
    });
    const stops = new Uint8Array((look.colours ? look.colours.stops : Array(17).fill("#c3c9d1"))
      .flatMap(hex => rgb(hex).map(c => Math.round(255 * c))));
    gl.bindTexture(gl.TEXTURE_2D, this.ramp);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, 17, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, stops);
    for (const [name, value] of [[gl.TEXTURE_MIN_FILTER, gl.LINEAR],
      [gl.TEXTURE_MAG_FILTER, gl.LINEAR], [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE]]) {
      gl.texParameteri(gl.TEXTURE_2D, name, value);
    }
    this.legend();
    this.draw();
  }

  camera() {
    const [a, t] = [this.yaw, this.tilt], [c, s] = [Math.cos(a), Math.sin(a)];
    const [d, u] = [Math.cos(t), Math.sin(t)];
    return product([c, -s, 0, s * u, c * u, d, -s * d, -c * d, u], this.scene.turn);
  }

  lift() { // levels go up in the view
    return [6, 7, 8].map(i => this.apart * this.scene.turn[i]);
  }

  draw() {
    if (this.waiting) return;
    this.waiting = requestAnimationFrame(time => { this.waiting = 0; this.paint(time); });
  }

  paint(time) {
    const gl = this.gl, look = this.look, style = getComputedStyle(document.documentElement);
    const ink = rgb(style.getPropertyValue("--ink").trim().replace(/^#(.)(.)(.)$/, "#$1$1$2$2$3$3"));
    if (this.playing) this.phase = Math.sin((time - this.playing) / 320);
    const swing = look.motion ? SWING * this.amplitude * this.phase : 0;
    const m = this.camera(), { width, height } = this.canvas;
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix3fv(this.at.turn, true, m);
    this.scale = this.zoom * this.fit();
    gl.uniform2f(this.at.zoom, this.scale * height / width, this.scale);
    gl.uniform2f(this.at.shift, this.shift[0], this.shift[1]);
    gl.uniform3fv(this.at.way, look.way || [0, 0, 0]);
    gl.uniform3fv(this.at.lift, this.lift());
    gl.uniform1f(this.at.swing, swing);
    gl.uniform1i(this.at.moving, look.way ? 1 : 0);
    gl.uniform3fv(this.at.none, ink[0] > 0.5 ? [0.42, 0.46, 0.52] : [0.78, 0.81, 0.85]);
    this.attribute(0, this.buffers[0], 3, gl.SHORT, true);
    this.attribute(1, this.buffers[1], 3, gl.SHORT, true);
    this.attribute(2, this.buffers[2], 1, gl.SHORT, true);
    this.attribute(3, this.buffers[3], 1, gl.UNSIGNED_SHORT, false);
    const part = (i, kind, plain, near, lit) => {
      gl.uniform4fv(this.at.plain, plain);
      gl.uniform1f(this.at.near, near);
      gl.uniform1i(this.at.lit, lit);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.indices[i]);
      gl.drawElements(kind, this.lists[i].length, gl.UNSIGNED_INT, 0);
    };
    if (this.rest && swing) {
      gl.uniform1f(this.at.swing, 0);
      part(2, gl.LINES, [...ink, 0.35], 0, 0);
      gl.uniform1f(this.at.swing, swing);
    }
    part(0, gl.TRIANGLES, [0, 0, 0, 0], 0, 1);
    if (this.edges) part(1, gl.LINES, [0.1, 0.12, 0.15, 0.22], 0.0004, 0);
    part(2, gl.LINES, [0.1, 0.12, 0.15, 0.75], 0.0006, 0);
    for (const a of this.arrows) {
      this.attribute(0, a.position, 3, gl.FLOAT, false);
      this.attribute(1, a.motion, 3, gl.FLOAT, false);
      this.attribute(2, null);
      this.attribute(3, null);
      gl.uniform4fv(this.at.plain, [...a.colour, 1]);
      gl.uniform1i(this.at.lit, 1);
      gl.drawArrays(gl.TRIANGLES, 0, a.count);
    }
    this.axes(m);
    if (this.playing) this.draw();
  }

  /** Where a vertex is drawn: across and up from the middle in half heights, and how near. */
  drawn(i, m, swing, lift) {
    const p = this.points, v = this.look.moved, l = this.levels ? this.levels[i] : 0;
    const x = [0, 1, 2].map(k => (p[3 * i + k] + (v ? swing * v[3 * i + k] : 0)) / 32767
      + l * lift[k]);
    return [0, 1, 2].map(r => m[3 * r] * x[0] + m[3 * r + 1] * x[1] + m[3 * r + 2] * x[2]);
  }

  /** Scale at which all is in the picture as first seen. */
  fit() {
    const across = this.canvas.width / this.canvas.height;
    return Math.min(0.93 * across / this.half[0], 0.93 / this.half[1]);
  }

  // -- how it is seen ----------------------------------------------------------------------

  home() {
    Object.assign(this, { yaw: TURN, tilt: TILT, zoom: 1, phase: 1, amplitude: 1, playing: 0,
      apart: this.scene.apart ? this.gap() : 0, edges: true });
    this.look = this.look || {};
    this.measure();
  }

  /** Middle and extents of all as seen now: what `fit` puts into the picture. */
  measure() {
    const m = this.camera(), lift = this.lift(), low = [9, 9], high = [-9, -9];
    for (let i = 0; i < this.scene.n; i += Math.ceil(this.scene.n / 4000)) {
      const [x, y] = this.drawn(i, m, 0, lift);
      low[0] = Math.min(low[0], x); high[0] = Math.max(high[0], x);
      low[1] = Math.min(low[1], y); high[1] = Math.max(high[1], y);
    }
    const room = this.scene.looks.some(l => l.motion) ? SWING : 0.02;
    this.half = [0, 1].map(k => (high[k] - low[k]) / 2 + room);
    this.middle = [0, 1].map(k => (high[k] + low[k]) / 2);
  }

  /** How far apart levels are at first: nothing hides what is below, as seen at first. */
  gap() {
    let low = 9, high = -9;
    const t = this.scene.turn;
    for (let i = 0; i < 3 * this.scene.n; i += 3) {
      const y = (t[3] * this.points[i] + t[4] * this.points[i + 1] + t[5] * this.points[i + 2])
        / 32767;
      low = Math.min(low, y); high = Math.max(high, y);
    }
    return 0.8 * (high - low) * Math.tan(TILT);
  }

  get shift() { // the middle of all in the middle of the picture, and where it was moved to
    const [x, y] = this.moved || [0, 0], height = this.canvas.height / this.canvas.width;
    return [(x - this.scale * this.middle[0]) * height, y - this.scale * this.middle[1]];
  }

  resize() {
    const wide = this.root.clientWidth, ratio = this.half[1] / this.half[0];
    const tall = Math.round(Math.min(Math.max(1.06 * wide * ratio, 200), 440, 1.1 * wide + 60));
    const pixels = Math.min(window.devicePixelRatio || 1, 2);
    this.canvas.style.height = `${tall}px`;
    this.canvas.width = Math.round(wide * pixels);
    this.canvas.height = Math.round(tall * pixels);
    this.draw();
  }

  // -- beside the picture ------------------------------------------------------------------

  controls() {
    const row = element("div", this.root, { className: "tools" }), looks = this.scene.looks;
    if (looks.length > 1) {
      const label = element("label", row, { textContent: "Show " });
      const list = this.list = element("select", label);
      looks.forEach((look, i) => element("option", list, { value: i, textContent: look.name }));
      list.onchange = () => this.choose(Number(list.value));
    }
    if (this.scene.tests.length) {
      const label = element("label", row, { textContent: "Test " });
      const list = this.testList = element("select", label);
      element("option", list, { value: -1, textContent: "none" });
      this.scene.tests.forEach((t, i) => element("option", list, { value: i, textContent: t.name }));
      list.onchange = () => this.choose(this.scene.looks.indexOf(this.look), Number(list.value));
    }
    const slider = (text, max, value, set) => {
      const label = element("label", row, { textContent: text });
      const range = element("input", label, { type: "range", min: 0, max, step: max / 60 });
      range.value = value;
      range.oninput = () => { set(Number(range.value)); this.draw(); };
      return range;
    };
    if (looks.some(look => look.motion)) {
      this.button = element("button", row, { type: "button", textContent: "Play" });
      this.button.onclick = () => this.play(!this.playing);
      slider("Amplitude ", 3, 1, x => { this.amplitude = x; });
    }
    if (this.scene.apart) slider("Apart ", 2 * this.apart, this.apart, x => { this.apart = x; });
    const tick = (into, text, on, set) => {
      const label = element("label", into), box = element("input", label, { type: "checkbox" });
      box.checked = on;
      label.append(` ${text}`);
      box.onchange = () => { set(box.checked); this.draw(); };
    };
    tick(row, "Mesh", this.edges, on => { this.edges = on; });
    if (looks.some(look => look.motion)) tick(row, "At rest", this.rest, on => { this.rest = on; });
    const press = (into, text, act) => {
      element("button", into, { type: "button", textContent: text }).onclick = act;
    };
    const views = element("span", row, { className: "views" });
    Object.keys(VIEWS).forEach((name, i) => press(views, name, () => this.stand(i)));
    press(row, "Picture", () => this.picture());
    if (looks.some(look => look.motion)) press(row, "GIF", () => this.movie());
    if (this.scene.parts.length) {
      const parts = element("details", this.root, { className: "parts" });
      element("summary", parts, { textContent: "Parts" });
      const boxes = element("div", parts, { className: "tools" });
      this.scene.parts.forEach((name, i) => tick(boxes, name, true, on => {
        this.hidden[on ? "delete" : "add"](i);
        this.sort();
      }));
    }
    this.key = element("div", this.root, { className: "key" });
    this.note = element("p", this.root, { className: "note" });
    this.tip = element("output", this.root, { className: "tip", hidden: true });
    this.triad = element("canvas", this.root, { className: "triad", width: 128, height: 128 });
    this.triad.setAttribute("aria-hidden", "true");
  }

  legend() {
    const { look, scene, key } = this;
    key.replaceChildren();
    if (look.colours) {
      const c = look.colours, bar = element("span", key);
      element("span", bar, { textContent: c.low });
      element("i", bar).style.background = `linear-gradient(to right, ${c.stops.join()})`;
      element("span", bar, { textContent: c.high });
      element("span", key, { textContent: c.label });
      if (c.none) {
        const grey = element("span", key);
        element("i", grey, { className: "box" });
        element("span", grey, { textContent: c.none });
      }
    }
    for (const a of this.shown) {
      const item = element("span", key);
      element("i", item, { className: "box" }).style.background = a.colour;
      element("span", item, { textContent: a.name });
    }
    const [drawn, whole] = scene.coarse;
    const coarse = whole ? ` Drawn coarser than the mesh: ${drawn} of ${whole} faces.` : "";
    const how = matchMedia("(pointer: coarse)").matches
      ? "Drag sideways to turn it, with two fingers to move and zoom."
      : "Drag to turn it, with Shift to move it; click, then roll the wheel to zoom; point at it "
        + "for values. Keys: arrows turn, + and - zoom, 1 to 4 are the views"
        + `${look.motion ? ", the space bar plays" : ""}.`;
    const beside = this.test < 0 ? "" : ` ${scene.tests[this.test].name} of the test, scaled to the `
      + `same length at the sensors: MAC ${look.mac[this.test].toFixed(3)}.`;
    this.note.textContent = `${look.note}${beside} ${how}${coarse}`;
  }

  /** The model's axes in a corner. */
  axes(m) {
    const pen = this.triad.getContext("2d");
    pen.clearRect(0, 0, 128, 128);
    pen.lineWidth = 3;
    pen.font = "24px sans-serif";
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    const style = getComputedStyle(document.documentElement);
    ["#d55e00", ...["--green", "--blue"].map(name => style.getPropertyValue(name))].forEach((colour, k) => {
      pen.strokeStyle = pen.fillStyle = colour;
      const [x, y] = [64 + 40 * m[k], 64 - 40 * m[3 + k]];
      pen.beginPath(); pen.moveTo(64, 64); pen.lineTo(x, y); pen.stroke();
      pen.fillText("xyz"[k], 64 + 54 * m[k], 64 - 54 * m[3 + k]);
    });
  }

  play(on) {
    this.playing = on ? performance.now() - 320 * Math.asin(this.phase) : 0;
    this.button.textContent = on ? "Pause" : "Play";
    if (!on) this.phase = 1;
    this.draw();
  }

  /** Look from one of the standard directions. */
  stand(number) {
    const [yaw, tilt] = Object.values(VIEWS)[number];
    Object.assign(this, { yaw, tilt, zoom: 1, moved: [0, 0] });
    this.measure();
    this.draw();
  }

  /** The canvas as it is now on the page's own ground, with the name of what is shown. */
  snapshot(scale) {
    const { width, height } = this.canvas, style = getComputedStyle(document.documentElement);
    const made = element("canvas", document.createDocumentFragment(), {
      width: Math.round(width * scale), height: Math.round(height * scale) });
    const pen = made.getContext("2d");
    pen.fillStyle = style.getPropertyValue("--paper");
    pen.fillRect(0, 0, made.width, made.height);
    pen.drawImage(this.canvas, 0, 0, made.width, made.height);
    pen.fillStyle = style.getPropertyValue("--ink");
    pen.font = `${Math.round(14 * scale * width / this.root.clientWidth)}px sans-serif`;
    const test = this.test < 0 ? "" : `, ${this.scene.tests[this.test].name} of the test, MAC `
      + this.look.mac[this.test].toFixed(3);
    const title = document.title.split(": ")[0];
    pen.fillText(`${title}: ${this.look.name}${test}`, 8, made.height - 10);
    return made;
  }

  get file() {
    return this.look.name.replace(/[^A-Za-z0-9]+/g, "_").slice(0, 60) || "view";
  }

  picture() {
    this.paint(performance.now());
    save(this.snapshot(1).toDataURL("image/png"), `${this.file}.png`);
  }

  /** One period of the motion as a GIF. */
  movie() {
    const { playing, phase } = this, scale = Math.min(1, WIDEST / this.canvas.width), frames = [];
    this.playing = 0;
    for (let i = 0; i < FRAMES; i++) {
      this.phase = Math.sin(2 * Math.PI * i / FRAMES);
      this.paint(0);
      const made = this.snapshot(scale);
      frames.push(made.getContext("2d").getImageData(0, 0, made.width, made.height));
    }
    Object.assign(this, { playing, phase });
    this.draw();
    const made = gif(frames, 8), address = URL.createObjectURL(made);
    save(address, `${this.file}.gif`);
    setTimeout(() => URL.revokeObjectURL(address), 1000);
    return made;
  }

  // -- pointer and keys --------------------------------------------------------------------

  listen() {
    const canvas = this.canvas, down = new Map();
    canvas.onpointerdown = event => {
      down.set(event.pointerId, [event.clientX, event.clientY]);
      canvas.setPointerCapture(event.pointerId);
    };
    canvas.onpointerup = canvas.onpointercancel = event => down.delete(event.pointerId);
    canvas.onpointerleave = () => { this.tip.hidden = true; };
    canvas.onpointermove = event => {
      const before = down.get(event.pointerId), now = [event.clientX, event.clientY];
      if (!before) return this.point(event);
      const move = [now[0] - before[0], now[1] - before[1]];
      if (down.size > 1) {
        const other = [...down].find(([id]) => id !== event.pointerId)[1];
        const length = p => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1;
        this.zoom *= length(now) / length(before);
        this.shove(move[0] / 2, move[1] / 2);
      } else if (event.shiftKey || event.buttons & 6) this.shove(...move);
      else this.rotate(move[0] / 180, move[1] / 180);
      down.set(event.pointerId, now);
      this.tip.hidden = true;
      this.draw();
    };
    canvas.addEventListener("wheel", event => {
      if (document.activeElement !== canvas && !event.ctrlKey) return;
      event.preventDefault();
      this.zoom = Math.min(Math.max(this.zoom * Math.exp(-event.deltaY / 600), 0.2), 60);
      this.draw();
    }, { passive: false });
    canvas.oncontextmenu = event => event.preventDefault();
    canvas.onkeydown = event => {
      const act = { ArrowLeft: () => this.rotate(-0.12, 0), ArrowRight: () => this.rotate(0.12, 0),
        ArrowUp: () => this.rotate(0, -0.12), ArrowDown: () => this.rotate(0, 0.12),
        "+": () => { this.zoom *= 1.15; }, "-": () => { this.zoom /= 1.15; },
        " ": () => this.button && this.play(!this.playing) }[event.key]
        || ("1" <= event.key && event.key <= "4" && (() => this.stand(event.key - 1)));
      if (!act || event.ctrlKey || event.altKey || event.metaKey) return;
      event.preventDefault();
      act();
      this.draw();
    };
    new ResizeObserver(() => this.resize()).observe(this.root);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  rotate(across, down) {
    this.yaw -= across;
    this.tilt = Math.min(Math.max(this.tilt + down, -1.57), 1.57);
  }

  shove(x, y) {
    const half = this.canvas.clientHeight / 2, [a, b] = this.moved || [0, 0];
    this.moved = [a + x / half, b - y / half];
  }

  /** What is said of the nearest vertex under the pointer. */
  point(event) {
    const box = this.canvas.getBoundingClientRect(), half = box.height / 2, look = this.look;
    const at = [(event.clientX - box.left - box.width / 2) / half,
      (box.top + half - event.clientY) / half];
    const m = this.camera(), swing = look.motion ? SWING * this.amplitude * this.phase : 0;
    const lift = this.lift(), [a, b] = this.moved || [0, 0], reach = (9 / half) ** 2;
    let best = -1, most = -9;
    for (let i = 0; i < this.scene.n; i++) {
      if (this.hidden.size && this.hidden.has(this.levels[i])) continue;
      const [x, y, z] = this.drawn(i, m, swing, lift);
      const off = (a + this.scale * (x - this.middle[0]) - at[0]) ** 2
        + (b + this.scale * (y - this.middle[1]) - at[1]) ** 2;
      if (off < reach && z > most) { most = z; best = i; }
    }
    this.tip.hidden = best < 0;
    if (best < 0) return;
    this.tip.textContent = this.words(best);
    const left = event.clientX - box.left;
    this.tip.style.left = `${Math.min(left + 12, Math.max(box.width - 230, 0))}px`;
    this.tip.style.top = `${event.clientY - box.top + 14}px`;
  }

  words(i) {
    const { look, scene, points } = this, parts = [];
    if (this.groups && look.texts.length) parts.push(look.texts[this.groups[i]]);
    if (look.shade && look.shown) {
      const [low, high, unit] = look.shown, x = look.shade[i] / 32767;
      if (x >= 0) parts.push(`${digits(low + (high - low) * x)} ${unit}`);
    }
    if (look.way) {
      const dot = [0, 1, 2].reduce((s, k) => s + look.moved[3 * i + k] * look.way[k], 0) / 32767;
      parts.push(`${dot.toFixed(2)} of the largest`);
    }
    const known = Math.max(0, -Math.ceil(Math.log10(scene.unit_mm / 32767)));
    const place = [0, 1, 2].map(k => String(Number(
      (scene.middle_mm[k] + scene.unit_mm * points[3 * i + k] / 32767).toFixed(known)) + 0)).join(", ");
    return [...parts, `at (${place}) mm`].join(" · ");
  }
}

// A value of the MAC shows its two shapes.
for (const cell of document.querySelectorAll("td[data-pair]")) {
  const show = () => {
    const stage = [...document.querySelectorAll(".stage.live")].find(s => s.view?.scene.tests.length);
    if (!stage) return;
    const [test, look] = cell.dataset.pair.split(",").map(Number);
    stage.view.choose(look, test);
    stage.scrollIntoView({ block: "center" });
  };
  const caption = cell.closest("table").caption;
  if (caption && !caption.querySelector(".screen")) {
    element("span", caption, { className: "screen", textContent: "; click a value to see both shapes" });
  }
  cell.tabIndex = 0;
  cell.setAttribute("role", "button");
  cell.onclick = show;
  cell.onkeydown = event => { if (event.key === "Enter") show(); };
}

for (const stage of document.querySelectorAll(".stage")) {
  const found = stage.querySelector(".view > script");
  try {
    if (found) new View(stage, JSON.parse(found.textContent));
  } catch (error) { // the picture is there all the same
    stage.classList.remove("live");
    console.error(error);
  }
}
