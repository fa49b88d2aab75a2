// Vectors, rigid motions, and the machine as a schematic of both.
const sum = (a, b, factor = 1) => a.map((one, k) => one + factor * b[k]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const scaled = (a, factor) => a.map((one) => one * factor);
const unit = (a) => scaled(a, 1 / (Math.hypot(...a) || 1));

// A rigid motion: the images of the unit vectors, and of the origin.
const STILL = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]];
const turned = (motion, v) => sum(sum(scaled(motion[0], v[0]), motion[1], v[1]), motion[2], v[2]);
const carried = (motion, p) => sum(turned(motion, p), motion[3]);
const after = (one, other) => [...other.slice(0, 3).map((v) => turned(one, v)), carried(one, other[3])];

const back = (one, p) => [0, 1, 2].map((k) => dot(one[k], sum(p, one[3], -1)));

// The motion of an axis by a command in mm or rad.
function motion(axis, command) {
  const by = axis.sense * command;
  if (!axis.turns) return [...STILL.slice(0, 3), scaled(axis.u, by)];
  const [c, s] = [Math.cos(by), Math.sin(by)];
  const about = (v) => sum(sum(scaled(v, c), cross(axis.u, v), s), axis.u, dot(axis.u, v) * (1 - c));
  return [...STILL.slice(0, 3).map(about), sum(axis.p, about(axis.p), -1)];
}

// The schematic: bodies with the motion that carries each, and how they hang together.
class Machine {
  constructor(data, low, high) {
    Object.assign(this, data);
    const size = Math.max(1, 0.7 * Math.hypot(...sum(high, low, -1)), this.length ?? 0);
    this.size = size;
    this.commands = this.axes.map((axis) => Math.min(Math.max(0, axis.range[0]), axis.range[1]) / (axis.turns ? 180 / Math.PI : 1));
    // Axes from the bed to the tool, and from the bed to the workpiece.
    this.chains = [
      this.axes.map((axis, k) => k).filter((k) => this.axes[k].tool),
      this.axes.map((axis, k) => k).filter((k) => !this.axes[k].tool).reverse(),
    ];
    const top = sum(this.tip, this.tool, this.length ?? size * 0.5);
    const base = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2] - 0.06 * size];
    this.top = top;
    this.base = base;
    // Where the body of each axis is drawn, all axes at zero: from the tool, and from the table, so that bodies stand above each
    // other when linear axes are in the middle of their travel. Anchors are the middles of guideways.
    const rest = this.commands;
    this.commands = this.axes.map((axis, k) => (axis.turns ? rest[k] : (axis.range[0] + axis.range[1]) / 2));
    const { of, tool, table } = this.motions();
    [this.nodes, this.anchors] = [[], []];
    const starts = [
      [carried(tool, top), scaled(turned(tool, this.tool), 0.3 * size)],
      [carried(table, base), [0, 0, -0.22 * size]],
    ];
    starts.forEach(([from, step], side) => {
      let at = from;
      for (const k of [...this.chains[side]].reverse()) {
        const axis = this.axes[k], [p, u] = [carried(of[k], axis.p), turned(of[k], axis.u)];
        at = axis.turns ? sum(p, u, dot(u, sum(at, p, -1))) : sum(at, step);
        this.nodes[k] = back(of[k], at);
        this.anchors[k] = axis.turns ? this.nodes[k] : sum(this.nodes[k], axis.u, axis.sense * this.commands[k]);
      }
    });
    this.commands = rest;
  }
  // The motions of all bodies, and of table and tool.
  motions() {
    const of = [];
    const ends = this.chains.map((chain) => {
      let all = STILL;
      for (const k of chain) all = of[k] = after(all, motion(this.axes[k], this.commands[k]));
      return all;
    });
    return { of, tool: ends[0], table: ends[1] };
  }
  // Edges and faces as [place, colour] triples, and labels.
  draw(faces, lines, colours) {
    const { of, tool, table } = this.motions();
    const size = this.size;
    const solid = (by, from, to, radius, sides, colour) => {
      const along = unit(sum(to, from, -1));
      const aside = unit(cross(along, Math.abs(along[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0]));
      const other = cross(along, aside);
      const corner = (end, side) => {
        const angle = ((side + 0.5) * 2 * Math.PI) / sides;
        return carried(by, sum(sum(end, aside, radius * Math.cos(angle)), other, radius * Math.sin(angle)));
      };
      for (let side = 0; side < sides; side++) {
        const [a, b, c, d] = [corner(from, side), corner(from, side + 1), corner(to, side + 1), corner(to, side)];
        // Faces that look to the side are a little darker.
        const shade = [...colour, 0.16 + 0.05 * (side % 2)];
        for (const p of [a, b, c, a, c, d]) faces.push(...p, ...shade);
        for (const [end, p, q] of [[from, a, b], [to, d, c]]) for (const r of [carried(by, end), p, q]) faces.push(...r, ...shade);
        const edge = [...colour, 0.8];
        for (const p of [a, b, d, c]) lines.push(...p, ...edge);
        if (sides < 9) for (const p of [a, d]) lines.push(...p, ...edge);
      }
    };
    const tags = [];
    const beam = (by, from, to, colour) => {
      if (Math.hypot(...sum(to, from, -1)) > 0.01 * size) solid(by, from, to, 0.05 * size, 4, colour);
    };
    this.chains.forEach((chain, side) => {
      let before = STILL;
      let last = null;
      for (const k of chain) {
        const [axis, node, by] = [this.axes[k], this.nodes[k], of[k]];
        const colour = colours[k % (colours.length - 1)];
        if (axis.turns) {
          const radius = axis.tool ? 0.16 : 0.34;
          solid(by, sum(node, axis.u, -0.04 * size), sum(node, axis.u, 0.04 * size), radius * size, 24, colour);
          for (const end of [-0.5, 0.5]) lines.push(...carried(by, sum(node, axis.u, end * size)), ...colour, 0.8);
        } else {
          // The guideway belongs to the body before, the carriage to its own.
          const [from, to] = axis.range;
          const end = (command, more) => sum(node, axis.u, axis.sense * (command + more * size));
          solid(before, end(from, -0.1), end(to, 0.1), 0.03 * size, 4, colour);
          solid(by, sum(node, axis.u, -0.14 * size), sum(node, axis.u, 0.14 * size), 0.11 * size, 4, colour);
        }
        if (last !== null) beam(before, this.nodes[last], this.anchors[k], colours[last % (colours.length - 1)]);
        tags.push([axis.name, carried(by, node)]);
        [before, last] = [by, k];
      }
      // The last body carries tool or table.
      const colour = last === null ? colours.at(-1) : colours[last % (colours.length - 1)];
      const end = side ? this.base : this.top;
      if (last !== null) beam(before, this.nodes[last], end, colour);
      if (side) solid(table, sum(end, [0, 0, -0.03 * size]), sum(end, [0, 0, 0.03 * size]), 0.5 * size, 4, colour);
      else solid(tool, this.tip, end, 0.025 * size, 12, colour);
    });
    // The bed joins the first bodies of both sides.
    const bed = colours.at(-1);
    const firsts = this.chains.map((chain, side) => (chain.length ? this.anchors[chain[0]] : side ? this.base : this.top));
    const low = firsts[1][2] - 0.2 * size;
    const behind = [firsts[0][0], firsts[0][1] + 0.35 * size, firsts[0][2]];
    solid(STILL, [firsts[1][0], firsts[1][1], low - 0.06 * size], [firsts[1][0], firsts[1][1], low], 0.7 * size, 4, bed);
    beam(STILL, [firsts[1][0], firsts[1][1], low], firsts[1], bed);
    beam(STILL, [behind[0], behind[1], low], behind, bed);
    beam(STILL, behind, firsts[0], bed);
    tags.push(["bed", [firsts[1][0], firsts[1][1], low]]);
    return { table, tags };
  }
}

