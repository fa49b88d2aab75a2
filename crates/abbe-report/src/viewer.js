// The viewer: points, residuals as arrows, the machine, the error field with slices and ellipsoids. Where there is no WebGL 2 the
// plane views are there all the same.

// A typed array from base64.
function numbers(kind, text) {
  return new kind(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);
}

const POINTS = `#version 300 es
in vec3 part; in vec3 to; in float value;
uniform vec3 low, high; uniform mat4 body; uniform mat3 turn; uniform vec3 middle; uniform vec4 zoom; uniform float longer;
uniform vec3 below, above; out vec4 shade;
void main() {
  vec3 at = low + part * (high - low) + float(gl_VertexID % 2) * longer * value / 1000.0 * to;
  at = turn * ((body * vec4(at, 1.0)).xyz - middle) * zoom.z;
  gl_Position = vec4(at.x * zoom.x, at.y * zoom.y, -at.z * 0.2, 1.0); gl_PointSize = zoom.w;
  shade = vec4(value < 0.0 ? below : above, 1.0); }`;
const PLAIN = `#version 300 es
in vec3 place; in vec4 colour;
uniform mat4 body; uniform mat3 turn; uniform vec3 middle; uniform vec4 zoom; out vec4 shade;
void main() {
  vec3 at = turn * ((body * vec4(place, 1.0)).xyz - middle) * zoom.z;
  gl_Position = vec4(at.x * zoom.x, at.y * zoom.y, -at.z * 0.2, 1.0); gl_PointSize = zoom.w; shade = colour; }`;
const SHADE = `#version 300 es
precision mediump float; in vec4 shade; out vec4 shown; void main() { shown = shade; }`;

function view(box) {
  const canvas = box.querySelector("canvas");
  const gl = canvas.getContext("webgl2", { antialias: true, alpha: true, premultipliedAlpha: false, preserveDrawingBuffer: true });
  if (!gl) return;
  const data = JSON.parse(box.dataset.scene);
  const part = (name) => box.querySelector(`[data-part="${name}"]`);
  const tell = (name, text) => (box.querySelector(`[data-told="${name}"]`).textContent = text);
  const points = data.points;
  const [low, high] = [0, 1].map((end) => points.tips.ranges.map((range) => range[end]));
  const tips = numbers(Uint16Array, points.tips.parts), commands = numbers(Uint16Array, points.commands.parts);
  const values = numbers(Float32Array, points.values), over = numbers(Int16Array, points.over);
  const lines = numbers(Uint32Array, points.lines), texts = numbers(Uint16Array, points.texts);
  const count = points.count;
  const tip = (i) => low.map((from, k) => from + ((high[k] - from) * tips[3 * i + k]) / 65535);
  const machine = data.machine && new Machine(data.machine, low, high);
  box.hidden = false;

  const program = (text) => {
    const made = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, text], [gl.FRAGMENT_SHADER, SHADE]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    return { made, at: (name) => gl.getUniformLocation(made, name), of: (name) => gl.getAttribLocation(made, name) };
  };
  const [dotted, plain] = [program(POINTS), program(PLAIN)];
  // The points stay on the graphics card, each twice for both ends of its arrow: a slider changes one number. Dots read every
  // second one.
  const buffers = [[tips, 3], [numbers(Int8Array, points.directions), 4], [values, 1]].map(([all, width]) => {
    const twice = new all.constructor(2 * all.length);
    for (let i = 0; i < twice.length; i++) twice[i] = all[Math.floor(i / (2 * width)) * width + (i % width)];
    const made = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, made);
    gl.bufferData(gl.ARRAY_BUFFER, twice, gl.STATIC_DRAW);
    return made;
  });
  const array = (every) => {
    const made = gl.createVertexArray();
    gl.bindVertexArray(made);
    const kinds = [["part", 3, gl.UNSIGNED_SHORT, true, 6], ["to", 3, gl.BYTE, true, 4], ["value", 1, gl.FLOAT, false, 4]];
    kinds.forEach(([name, size, kind, norm, step], index) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffers[index]);
      gl.enableVertexAttribArray(dotted.of(name));
      gl.vertexAttribPointer(dotted.of(name), size, kind, norm, every * step, 0);
    });
    return made;
  };
  const [arrows, dots] = [array(1), array(2)];
  // While the view turns, one in so many dots is enough.
  const every = Math.ceil(count / 10000), some = array(2 * every);
  let in_motion = false;
  const scratch = { array: gl.createVertexArray(), buffer: gl.createBuffer() };

  const field = numbers(Float32Array, data.field.places);
  const shown = data.shown.map((one) => [one.field, one.volume].map((text) => numbers(Float32Array, text)));
  const volume = data.volume && { ...data.volume, places: numbers(Float32Array, data.volume.places) };
  const ellipsoids = data.ellipsoids && [data.ellipsoids.places, data.ellipsoids.axes].map((text) => numbers(Float32Array, text));
  const three = (all, i) => [all[3 * i], all[3 * i + 1], all[3 * i + 2]];

  const with_machine = () => machine !== null && part("machine").checked;
  let around = -0.6, up = 0.35, zoom = 1.2, picked = -1;
  const turn = () => {
    const [c, s, d, t] = [Math.cos(around), Math.sin(around), Math.cos(up), Math.sin(up)];
    // Columns: where X, Y and Z of the table go; Z stands up.
    return [c, s * t, -s * d, -s, c * t, -c * d, 0, d, t];
  };
  const colour = (name) => {
    const text = getComputedStyle(document.documentElement).getPropertyValue(name).trim();
    return [1, 3, 5].map((k) => parseInt(text.slice(k, k + 2), 16) / 255);
  };
  const times = (name) => {
    const input = part(name);
    if (!input) return 0;
    const factor = name === "ellipsoids" && input.value === "0" ? 0 : Math.round(10 ** Number(input.value));
    tell(name, String(factor));
    return factor;
  };
  const errors = () => shown[part("shown")?.value ?? 0] ?? [new Float32Array(), new Float32Array()];

  // A slice: errors between the grid's places, as colours from small to large.
  const slice = (faces, small, large) => {
    const across = part("slice")?.value;
    if (!volume || across === "") return tell_slice("");
    const sizes = volume.axes.map((axis) => axis.at.length), k = Number(across);
    const index = (at) => at.reduce((all, one, axis) => all * sizes[axis] + one, 0);
    const where = Number(part("at").value) * (sizes[k] - 1), before = Math.min(Math.floor(where), sizes[k] - 2);
    const rest = [0, 1, 2].filter((axis) => axis !== k && axis < sizes.length);
    const of = (all, cell) => {
      const at = [];
      rest.forEach((axis, n) => (at[axis] = cell[n]));
      const [one, other] = [before, before + 1].map((step) => three(all, index(Object.assign([...at], { [k]: step }))));
      return sum(scaled(one, 1 - (where - before)), other, where - before);
    };
    const [error, longer] = [errors()[1], times("errors")];
    // One scale for the whole volume.
    let most = 1e-12;
    for (let i = 0; i < error.length / 3; i++) most = Math.max(most, Math.hypot(...three(error, i)));
    const [near, far] = [[Infinity], [0]];
    const corner = (cell) => {
      const size = Math.hypot(...of(error, cell));
      [near[0], far[0]] = [Math.min(near[0], size), Math.max(far[0], size)];
      const place = sum(of(volume.places, cell), of(error, cell), longer);
      return [...place, ...sum(scaled(small, 1 - size / most), large, size / most), 0.75];
    };
    const [wide, high] = [sizes[rest[0]], rest.length > 1 ? sizes[rest[1]] : 1];
    for (let i = 0; i + 1 < wide; i++)
      for (let j = 0; j + 1 < high; j++) {
        const [a, b, c, d] = [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]].map(corner);
        for (const p of [a, b, c, a, c, d]) faces.push(...p);
      }
    const [from, to] = [volume.axes[k].at[before], volume.axes[k].at[before + 1]];
    const others = volume.others ? `, ${volume.others}` : "";
    tell_slice(`${volume.axes[k].name} ${Math.round(from + (to - from) * (where - before)) + 0} mm${others}: error ` +
      `${(near[0] * 1000).toPrecision(3)} to ${(far[0] * 1000).toPrecision(3)} µm`);
  };
  const tell_slice = (text) => part("at") && tell("at", text);

  // What is drawn beside the points is made anew when a slider moves, not when the view turns.
  let lists = null;
  const made = () => {
    const [small, large, soft, text] = ["--s0", "--s1", "--soft", "--text"].map(colour);
    const own = ["--s2", "--s3", "--s4", "--s0", "--s1", "--soft"].map(colour);
    const found = { faces: [], lines: [], solids: [], edges: [], table: STILL, tags: [], small, large, text };
    if (with_machine()) Object.assign(found, machine.draw(found.solids, found.edges, own));
    const [error, longer, wider] = [errors()[0], times("errors"), times("ellipsoids")];
    for (let i = 0; i < field.length / 3; i++) {
      const place = three(field, i);
      found.lines.push(...place, ...soft, 0.9, ...sum(place, three(error, i), longer), ...soft, 0.9);
    }
    if (ellipsoids && wider)
      for (let i = 0; i < ellipsoids[0].length / 3; i++) {
        const [place, half] = [three(ellipsoids[0], i), [0, 1, 2].map((k) => scaled(three(ellipsoids[1], 3 * i + k), wider))];
        for (const [one, other] of [[0, 1], [1, 2], [2, 0]])
          for (let step = 0; step < 48; step++) {
            const angle = (Math.ceil(step / 2) * Math.PI) / 12;
            found.lines.push(...sum(sum(place, half[one], Math.cos(angle)), half[other], Math.sin(angle)), ...text, 0.9);
          }
      }
    slice(found.faces, small, large);
    for (const name of ["faces", "lines", "solids", "edges"]) found[name] = new Float32Array(found[name]);
    return found;
  };

  // The middle and half the size of what is shown.
  const extent = () => {
    const [least, most] = [[...low], [...high]];
    const grow = (all, step) => {
      for (let i = 0; i < all.length; i += step)
        for (let k = 0; k < 3; k++) [least[k], most[k]] = [Math.min(least[k], all[i + k]), Math.max(most[k], all[i + k])];
    };
    grow(field, 3);
    if (with_machine()) grow(lists.edges, 7);
    return [scaled(sum(least, most), 0.5), Math.max(1e-6, Math.hypot(...sum(most, least, -1)) / 2)];
  };
  let frame = null;
  const tags = [];
  const tag = (index, text, place, by) => {
    const label = { className: "tag", ariaHidden: "true" };
    tags[index] ??= canvas.parentElement.appendChild(Object.assign(document.createElement("span"), label));
    const [x, y] = seen(place, by);
    tags[index].textContent = text;
    Object.assign(tags[index].style, { left: `${x}px`, top: `${y}px` });
  };
  // Where a place stands on the canvas.
  const seen = (place, by) => {
    const [t, d] = [turn(), sum(carried(by, place), frame.middle, -1)];
    const scale = ((zoom / frame.size) * Math.min(canvas.clientWidth, canvas.clientHeight)) / 2;
    const side = (k) => (t[k] * d[0] + t[3 + k] * d[1] + t[6 + k] * d[2]) * scale;
    return [canvas.clientWidth / 2 + side(0), canvas.clientHeight / 2 - side(1)];
  };

  const paint = () => {
    const [wide, tall] = [canvas.clientWidth, canvas.clientHeight];
    if (!wide || !tall) return;
    const fine = Math.min(devicePixelRatio || 1, 2);
    if (canvas.width !== wide * fine || canvas.height !== tall * fine) [canvas.width, canvas.height] = [wide * fine, tall * fine];
    lists ??= made();
    if (!frame) {
      const [middle, size] = extent();
      frame = { middle, size };
    }
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const use = (which, by, size) => {
      gl.useProgram(which.made);
      gl.uniformMatrix4fv(which.at("body"), false, [...by[0], 0, ...by[1], 0, ...by[2], 0, ...by[3], 1]);
      gl.uniformMatrix3fv(which.at("turn"), false, turn());
      gl.uniform3fv(which.at("middle"), frame.middle);
      gl.uniform4f(which.at("zoom"), Math.min(1, tall / wide), Math.min(1, wide / tall), zoom / frame.size, size);
    };
    const draw = (kind, list, by, size = 1) => {
      if (!list.length) return;
      use(plain, by, size);
      gl.bindVertexArray(scratch.array);
      gl.bindBuffer(gl.ARRAY_BUFFER, scratch.buffer);
      gl.bufferData(gl.ARRAY_BUFFER, list, gl.DYNAMIC_DRAW);
      for (const [name, wide, from] of [["place", 3, 0], ["colour", 4, 12]]) {
        gl.enableVertexAttribArray(plain.of(name));
        gl.vertexAttribPointer(plain.of(name), wide, gl.FLOAT, false, 28, from);
      }
      gl.drawArrays(kind, 0, list.length / 7);
    };
    use(dotted, lists.table, 5 * fine);
    gl.uniform3fv(dotted.at("low"), low);
    gl.uniform3fv(dotted.at("high"), high);
    gl.uniform3fv(dotted.at("below"), lists.small);
    gl.uniform3fv(dotted.at("above"), lists.large);
    gl.uniform1f(dotted.at("longer"), times("arrows"));
    const few = in_motion && every > 1;
    if (!few) {
      gl.bindVertexArray(arrows);
      gl.drawArrays(gl.LINES, 0, 2 * count);
    }
    gl.uniform1f(dotted.at("longer"), 0);
    gl.bindVertexArray(few ? some : dots);
    gl.drawArrays(gl.POINTS, 0, few ? Math.floor(count / every) : count);
    draw(gl.LINES, lists.lines, lists.table);
    draw(gl.LINES, lists.edges, STILL);
    // What one sees through comes last, and hides nothing.
    gl.depthMask(false);
    draw(gl.TRIANGLES, lists.faces, lists.table);
    draw(gl.TRIANGLES, lists.solids, STILL);
    gl.depthMask(true);
    if (picked >= 0) {
      gl.disable(gl.DEPTH_TEST);
      draw(gl.POINTS, new Float32Array([...tip(picked), ...lists.text, 1]), lists.table, 13 * fine);
      const own = values[picked] < 0 ? lists.small : lists.large;
      draw(gl.POINTS, new Float32Array([...tip(picked), ...own, 1]), lists.table, 8 * fine);
    }
    lists.tags.forEach(([text, place], index) => tag(index, text, place, STILL));
    tags.slice(lists.tags.length).forEach((one) => (one.textContent = ""));
  };
  let waiting = false;
  const repaint = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      paint();
    });
  };
  let calm = 0;
  const move = () => {
    in_motion = true;
    clearTimeout(calm);
    calm = setTimeout(() => {
      in_motion = false;
      repaint();
    }, 200);
    repaint();
  };
  const renew = () => {
    lists = null;
    repaint();
  };

  // The machine goes where a slider, or a row, sends it.
  const axis_told = (k) => {
    const { turns } = machine.axes[k];
    const told = box.querySelector(`[data-told-axis="${k}"]`);
    if (told) told.textContent = (machine.commands[k] * (turns ? 180 / Math.PI : 1)).toFixed(1);
  };
  const send = (index) => {
    machine.axes.forEach(({ turns, column }, k) => {
      if (column === null) return;
      const [from, to] = points.commands.ranges[column], wide = points.commands.ranges.length;
      const at = from + ((to - from) * commands[wide * index + column]) / 65535;
      machine.commands[k] = turns ? (at * Math.PI) / 180 : at;
      const slider = box.querySelector(`[data-axis="${k}"]`);
      if (slider) slider.value = at;
      axis_told(k);
    });
    lists = null;
  };
  const pick = (index) => {
    if (!(index >= 0 && index < count)) return;
    picked = index;
    const [stage, file] = [0, 1].map((k) => points.names[texts[2 * index + k]]);
    const [line, row] = lines.subarray(2 * index, 2 * index + 2);
    part("picked").textContent = `${file}${line > 0 ? `:${line}` : ""} (row ${row}), ${stage}: residual ${values[index].toPrecision(4)} µm, ` +
      `${(over[index] / 100).toFixed(1)} of its uncertainty`;
    if (machine) send(index);
    repaint();
  };
  const pickAt = (x, y) => {
    let [best, nearest] = [-1, 15 * 15];
    // From parts of the ranges to the canvas all is linear: four places tell it.
    const [start, ...ends] = [0, 1, 2, 3].map((which) => seen(low.map((from, k) => (k === which - 1 ? high[k] : from)), lists.table));
    const [across, down] = [0, 1].map((part) => ends.map((end) => (end[part] - start[part]) / 65535));
    for (let i = 0; i < count; i++) {
      const at = (of, from) => from + of[0] * tips[3 * i] + of[1] * tips[3 * i + 1] + of[2] * tips[3 * i + 2];
      const away = (at(across, start[0]) - x) ** 2 + (at(down, start[1]) - y) ** 2;
      if (away < nearest) [best, nearest] = [i, away];
    }
    pick(best);
  };

  let from = null, moved = false;
  canvas.addEventListener("pointerdown", (event) => {
    from = [event.clientX, event.clientY];
    moved = false;
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!from) return;
    const [x, y] = [event.clientX - from[0], event.clientY - from[1]];
    if (!moved && Math.hypot(x, y) < 4) return;
    moved = true;
    from = [event.clientX, event.clientY];
    around += x * 0.01;
    up = Math.max(-1.57, Math.min(1.57, up + y * 0.01));
    move();
  });
  canvas.addEventListener("pointerup", (event) => {
    const place = canvas.getBoundingClientRect();
    if (from && !moved) pickAt(event.clientX - place.left, event.clientY - place.top);
    from = null;
  });
  const closer = (by) => {
    zoom = Math.max(0.1, Math.min(50, zoom * by));
    move();
  };
  canvas.addEventListener("wheel", (event) => {
    // The page scrolls unless somebody works with the view.
    if (document.activeElement !== canvas) return;
    event.preventDefault();
    closer(Math.exp(-event.deltaY * 0.001));
  }, { passive: false });
  const keys = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
  canvas.addEventListener("keydown", (event) => {
    if (event.key === "+") return closer(1.2);
    if (event.key === "-") return closer(1 / 1.2);
    const by = keys[event.key];
    if (!by) return;
    event.preventDefault();
    around += by[0];
    up = Math.max(-1.57, Math.min(1.57, up + by[1]));
    move();
  });
  part("arrows").addEventListener("input", repaint);
  for (const name of ["errors", "ellipsoids", "shown", "slice", "at"]) part(name)?.addEventListener("input", renew);
  part("machine")?.addEventListener("input", () => {
    frame = null;
    renew();
  });
  for (const slider of box.querySelectorAll("[data-axis]")) {
    const k = Number(slider.dataset.axis);
    slider.addEventListener("input", () => {
      machine.commands[k] = Number(slider.value) * (machine.axes[k].turns ? Math.PI / 180 : 1);
      axis_told(k);
      renew();
    });
    axis_told(k);
  }
  const order = [...Array(count).keys()].sort((a, b) => Math.abs(over[b]) - Math.abs(over[a]));
  let next = 0;
  part("worse").addEventListener("click", () => pick(order[next++ % count]));
  const number = box.id.split("-")[1];
  const follow = () => {
    const found = /^#point-([0-9]+)-([0-9]+)$/.exec(location.hash);
    if (!found || found[1] !== number) return;
    pick(Number(found[2]));
    box.scrollIntoView();
  };
  addEventListener("hashchange", follow);
  addEventListener("resize", repaint);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", renew);
  // The machine stands where the first row was measured.
  if (machine && count) send(0);
  paint();
  follow();
}
for (const box of document.querySelectorAll(".viewer")) view(box);
