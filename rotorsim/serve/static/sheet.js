// The sheet: blocks, ports and wires as SVG; shifting it, dragging of blocks, wiring from port to port.

import { html, useEffect, useRef } from "./vendor/htm-preact-3.1.1.module.js";
import { app, cell, chosen, edit, live, move, moveBy, readOnly, select, set, valueAt } from "./app.js";
import { bring, camera, fit, focusBlock, found, look, place, sheet, zoom } from "./camera.js";
import { editable, isChosen, selectAll, toggle } from "./selection.js";

const path = (points) => "M" + points.map(([x, y]) => `${x},${y}`).join(" L");

// Follows the pointer until it is let go, or Escape: then done has no event. moved is called once a frame at most.
export function follow(moved, done) {
  let last = null;
  const draw = () => {
    const at = last;
    last = null;
    if (at) moved(at);
  };
  const onMove = (next) => {
    if (!last) requestAnimationFrame(draw);
    last = next;
  };
  const listeners = {
    pointermove: onMove,
    pointerup: (next) => end(next),
    pointercancel: () => end(null),
    keydown: (pressed) => {
      if (pressed.key !== "Escape") return;
      pressed.stopPropagation();
      end(null);
    },
  };
  const end = (next) => {
    for (const [name, listener] of Object.entries(listeners)) removeEventListener(name, listener, true);
    last = null;
    done(next);
  };
  for (const [name, listener] of Object.entries(listeners)) addEventListener(name, listener, true);
}

function pan(event) {
  if (event.button !== 0 && event.button !== 1) return;
  if (event.shiftKey) return band(event);
  const start = [event.clientX - camera.x, event.clientY - camera.y];
  let far = false;
  follow(
    (next) => {
      camera.x = next.clientX - start[0];
      camera.y = next.clientY - start[1];
      far = true;
      look();
    },
    () => far || select(null),
  );
}

// Selects the blocks inside of a frame, beside those that are.
function band(event) {
  const [x0, y0] = place(event);
  const frame = document.querySelector(".rubber");
  let at = [x0, y0];
  follow(
    (next) => {
      at = place(next);
      frame.setAttribute("d", `${path([[x0, y0], [at[0], y0], at, [x0, at[1]]])} z`);
    },
    (next) => {
      frame.setAttribute("d", "");
      if (!next) return;
      const [left, right] = [Math.min(x0, at[0]), Math.max(x0, at[0])];
      const [top, bottom] = [Math.min(y0, at[1]), Math.max(y0, at[1])];
      const inside = app.state.view.blocks.filter(
        (one) => one.editable && one.x >= left && one.x + one.width <= right && one.y >= top && one.y + one.height <= bottom,
      );
      selectAll([...new Set([...chosen(), ...inside.map((one) => one.name)])]);
    },
  );
}

// Where a block would stand: the column or row there, or the gap between two, from start to end [px].
function span(cells, start, end, at) {
  const k = cells.findIndex((cell) => at <= cell[end]);
  const last = cells[cells.length - 1];
  if (k < 0) return [last[end] + 10, last[end] + 90];
  if (at >= cells[k][start]) return [cells[k][start], cells[k][end]];
  return k ? [cells[k - 1][end] + 4, cells[k][start] - 4] : [cells[0][start] - 90, cells[0][start] - 10];
}

function frameOf(u, v) {
  const { columns, rows } = app.state.view;
  const [left, right] = span(columns, "left", "right", u);
  const [top, bottom] = span(rows, "top", "bottom", v);
  return `${path([[left, top], [right, top], [right, bottom], [left, bottom]])} z`;
}

function dragBlock(event, one) {
  if (event.button !== 0) return;
  event.stopPropagation();
  if (event.shiftKey) {
    event.preventDefault(); // the focus would select it alone
    return toggle(one.name);
  }
  const together = isChosen(one.name) && chosen().length > 1;
  if (!together) select({ block: one.name });
  focusBlock(one.name);
  if (readOnly() || !one.editable) return;
  const moved = together ? editable() : [one];
  const groups = moved.map((each) => document.querySelector(`[data-block="${CSS.escape(each.name)}"]`));
  const [x0, y0] = place(event);
  const own = new Set(moved.flatMap((each) => [...each.inputs, ...each.outputs].map((port) => `${each.name}.${port.name}`)));
  const bare = (end) => end.replace(/\[.*$/, "");
  const attached = app.state.view.wires
    .filter((wire) => own.has(bare(wire.source)) || own.has(bare(wire.target)))
    .map((wire) => [wire, [...document.querySelectorAll(`[data-wire="${CSS.escape(`${wire.source}>${wire.target}`)}"]`)]]);
  const shift = (paths, [dx, dy]) => paths[0]?.parentNode.querySelector(".head").setAttribute("transform", `translate(${dx} ${dy})`);
  const goal = document.querySelector(".rubber");
  let by = [0, 0];
  follow(
    (next) => {
      const [x, y] = place(next);
      by = [x - x0, y - y0];
      for (const group of groups) {
        group.setAttribute("transform", `translate(${by[0]} ${by[1]})`);
        group.classList.add("dragged");
      }
      goal.setAttribute("d", frameOf(one.x + by[0] + one.width / 2, one.y + by[1] + one.height / 2));
      for (const [wire, paths] of attached) {
        const [start, end] = [wire.points[0], wire.points[wire.points.length - 1]];
        const from = own.has(bare(wire.source)) ? [start[0] + by[0], start[1] + by[1]] : start;
        const to = own.has(bare(wire.target)) ? [end[0] + by[0], end[1] + by[1]] : end;
        for (const each of paths) each.setAttribute("d", path([from, to]));
        if (to !== end) shift(paths, by);
      }
    },
    async (next) => {
      goal.setAttribute("d", "");
      for (const group of groups) group.classList.remove("dragged");
      const back = () => {
        for (const group of groups) group.removeAttribute("transform");
        for (const [wire, paths] of attached) {
          for (const each of paths) each.setAttribute("d", path(wire.points));
          shift(paths, [0, 0]);
        }
      };
      if (!next || Math.hypot(...by) * camera.k < 4) {
        if (next && together) select({ block: one.name }); // a click on one of several
        return back();
      }
      const view = app.state.view;
      const column = valueAt(view.columns, "left", "right", one.x + by[0] + one.width / 2);
      const row = valueAt(view.rows, "top", "bottom", one.y + by[1] + one.height / 2);
      const [c, r] = cell(one);
      await (together ? moveBy(moved.map((each) => each.name), column - c, row - r) : move(one.name, column, row));
      back();
    },
  );
}

async function dragWire(event, port, outward) {
  if (event.button !== 0 || readOnly()) return;
  event.stopPropagation();
  const [x0, y0] = place(event);
  const line = document.querySelector(".rubber");
  let fits = null;
  let held = true;
  follow(
    (next) => line.setAttribute("d", path([[x0, y0], place(next)])),
    (next) => {
      held = false;
      line.setAttribute("d", "");
      light(null);
      const over = next && document.elementFromPoint(next.clientX, next.clientY)?.closest("[data-port]");
      const other = over?.dataset.port;
      if (!other || other === port) return;
      const why = (over.dataset.side === "out") === outward ? "a wire goes from an output to an input" : fits?.get(other)?.why;
      if (why) return refuse(other, why);
      edit([outward ? { op: "wire", source: port, target: other } : { op: "wire", source: other, target: port }]);
    },
  );
  const answer = await live.ask({ kind: "fits", port });
  if (answer.kind !== "fits" || !held) return;
  fits = new Map(answer.ports.map((one) => [one.port, one]));
  light(fits, outward);
}

function refuse(port, why) {
  const [owner, name] = port.split(/\.(?=[^.]*$)/);
  const problem = { severity: "error", what: why, subject: port, hint: "", place: "", block: owner, port: name };
  set({ refused: [problem], said: `not wired: ${port} ${why}` });
}

// Lights up the ports that fit, and says at the others why they do not.
function light(fits, outward) {
  for (const port of document.querySelectorAll("[data-port]")) {
    const one = fits?.get(port.dataset.port);
    const asked = one && (port.dataset.side === "in") === outward;
    port.classList.toggle("fits", !!(asked && one.ok));
    port.classList.toggle("unfit", !!(fits && !(asked && one.ok)));
    port.querySelector("title").textContent = asked && !one.ok ? `${one.port}: ${one.why}` : port.dataset.said;
  }
}

// What is wrong, told by shape, too: a triangle with "!" for a mistake, a circle with "?" for a warning.
function Mark({ x, y, problem }) {
  const error = problem.severity === "error";
  return html`<g class=${`flag ${problem.severity}`}>${error ? html`<path d=${`M${x},${y - 8} l9,15 h-18 z`} />` : html`<circle cx=${x} cy=${y} r="8" />`}
    <text x=${x} y=${y + (error ? 5.5 : 4)}>${error ? "!" : "?"}</text><title>${problem.what}</title></g>`;
}

// A port of the diagram itself: a tag with its name at the port that it leads to.
function Outside({ port, inward }) {
  const name = port.exposed.map(([name]) => name).join(", ");
  const tip = port.x + (inward ? -9 : 18);
  const end = inward ? "end" : "start";
  return html`<g class="outside"><path d=${`M${tip},${port.y} l-8,-4.5 v9 z`} />
    <text x=${tip + (inward ? -10 : 3)} y=${port.y + (inward ? 3.5 : -4)} text-anchor=${end}>${name}</text><title>${`port ${name} of this diagram`}</title></g>`;
}

function Port({ owner, port, side, problem }) {
  const name = `${owner.name}.${port.name}`;
  const shape = port.shape === "scalar" ? "" : `, ${port.shape}`;
  const said = `${name} [${port.unit}${shape}]${port.wired || port.optional || port.exposed.length ? "" : ", not wired"}`;
  const inward = side === "in";
  return html`<g class=${`port ${port.wired ? "wired" : "open"}`} data-port=${name} data-side=${side} data-said=${said}
      data-testid=${`port-${name}-${side}`} onPointerDown=${(event) => dragWire(event, name, !inward)}>
    <circle class="hit" cx=${port.x} cy=${port.y} r="8" /><circle class="dot" cx=${port.x} cy=${port.y} r="3.2" />
    ${owner.plain ? null : html`<text x=${port.x + (inward ? 7 : -7)} y=${port.y + 3.5} text-anchor=${inward ? "start" : "end"}>${port.name}</text>`}
    ${port.exposed.length ? html`<${Outside} port=${port} inward=${inward} />` : null}
    ${port.sign && html`<text class="sign" x=${port.x + 6} y=${port.y + 4}>${port.sign}</text>`}
    <title>${said}</title>
    ${problem && html`<${Mark} x=${port.x + (inward ? -15 : 15)} y=${port.y} problem=${problem} />`}
  </g>`;
}

function Block({ one, problems }) {
  const selected = isChosen(one.name);
  const middle = one.x + one.width / 2;
  const base = one.y + (one.plain ? one.height / 2 - 3 : 16);
  const own = problems.find((each) => !each.port) ?? problems[0];
  const classes = ["block", selected && "chosen", one.editable || "inner", found(one) && "found"].filter((each) => typeof each === "string");
  return html`<g class=${classes.join(" ")} data-block=${one.name} data-testid=${`block-${one.name}`} tabindex="0" role="button"
      aria-label=${`${one.name}, ${one.kind}${own ? `, ${own.severity}: ${own.what}` : ""}`} aria-pressed=${selected}
      onPointerDown=${(event) => dragBlock(event, one)} onFocus=${(event) => {
        if (!isChosen(one.name)) select({ block: one.name });
        if (event.currentTarget.matches(":focus-visible")) bring(one.name);
      }}>
    <rect x=${one.x} y=${one.y} width=${one.width} height=${one.height} rx="5" fill=${one.fill} />
    <text class="title" x=${middle} y=${base}>${one.name}</text>
    <text class="kind" x=${middle} y=${base + 14}>${one.kind}</text>
    ${one.inputs.map((port) => html`<${Port} key=${`i${port.name}`} owner=${one} port=${port} side="in" problem=${problems.find((each) => each.port === port.name)} />`)}
    ${one.outputs.map((port) => html`<${Port} key=${`o${port.name}`} owner=${one} port=${port} side="out" problem=${problems.find((each) => each.port === port.name)} />`)}
    ${own && html`<${Mark} x=${one.x + one.width - 8} y=${one.y - 2} problem=${own} />`}
  </g>`;
}

const isWireChosen = (wire) => app.selected?.wire?.[0] === wire.source && app.selected?.wire?.[1] === wire.target;

function Wire({ wire }) {
  const chosen = isWireChosen(wire);
  const key = `${wire.source}>${wire.target}`;
  const [x, y] = wire.points[wire.points.length - 1];
  const choose = (event) => {
    event.stopPropagation();
    select({ wire: [wire.source, wire.target] });
  };
  return html`<g class=${`wire ${chosen ? "chosen" : ""}`} onPointerDown=${(event) => event.stopPropagation()} onClick=${choose}
      data-testid=${`wire-${wire.source}-${wire.target}`}>
    <path class="hit" data-wire=${key} d=${path(wire.points)} /><path class="line" data-wire=${key} d=${path(wire.points)} stroke=${wire.colour} />
    <path class="head" d=${`M${x},${y} l-7,-3.2 v6.4 z`} fill=${wire.colour} />
    ${wire.index_target && html`<text x=${wire.points[0][0] + 6} y=${wire.points[0][1] - 4} fill=${wire.colour}>${wire.index_target}</text>`}
    ${wire.index_source && html`<text x=${x - 9} y=${y - 4} text-anchor="end" fill=${wire.colour}>${wire.index_source}</text>`}
    <title>${`${wire.source} to ${wire.target}, ${wire.unit}, ${wire.shape}`}</title>
  </g>`;
}

// The picture, made anew only when something in it has changed: other parts of the page are drawn more often.
const drawn = { state: null, parts: new Map(), problems: new Map() };

function kept(key, of, make) {
  const last = drawn.parts.get(key);
  if (last && of.every((one, k) => one === last.of[k])) return last.made;
  const made = make();
  drawn.parts.set(key, { of, made });
  return made;
}

function picture() {
  const { state, selected, search } = app;
  const { view } = state;
  if (drawn.state !== state) {
    drawn.state = state;
    drawn.parts.clear();
    drawn.problems = Map.groupBy(state.problems.filter((one) => one.block), (one) => one.block);
  }
  const wire = (one) => {
    const key = `${one.source}>${one.target}`;
    return kept(key, [isWireChosen(one)], () => html`<${Wire} key=${key} wire=${one} />`);
  };
  const block = (one) =>
    kept(one.name, [isChosen(one.name), found(one)], () => html`<${Block} key=${one.name} one=${one} problems=${drawn.problems.get(one.name) ?? []} />`);
  return kept("", [selected, search], () => html`<g>${view.wires.map(wire)}
    ${view.dots.map(([x, y, colour]) => html`<circle cx=${x} cy=${y} r="2.4" fill=${colour} />`)}${view.blocks.map(block)}</g>`);
}

export function Sheet() {
  const view = app.state.view;
  const box = useRef(null);
  useEffect(() => {
    const wheel = (event) => {
      event.preventDefault();
      const at = sheet().getBoundingClientRect();
      zoom(Math.exp(-event.deltaY / 500), event.clientX - at.left, event.clientY - at.top);
    };
    const element = box.current;
    element?.addEventListener("wheel", wheel, { passive: false });
    return () => element?.removeEventListener("wheel", wheel);
  }, [!!view]);
  useEffect(() => {
    const shown = `${app.state.file} ${app.state.part}`;
    if (view && camera.fitted !== shown) {
      camera.fitted = shown;
      fit();
    }
  });
  if (!view) return html`<div class="sheet empty"><p>There is no picture of this file yet: it has mistakes.</p></div>`;
  return html`<svg class="sheet" data-testid="sheet" ref=${box} onPointerDown=${pan} aria-label=${`Diagram ${view.name}`}>
    <g class="world" transform=${`translate(${camera.x} ${camera.y}) scale(${camera.k})`}>
      ${picture()}<path class="rubber" d="" />
    </g>
  </svg>`;
}
