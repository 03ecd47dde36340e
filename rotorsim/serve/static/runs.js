// Runs: parameters to move, results kept side by side, time histories, orbits, analyses and figures.

import uPlot from "./vendor/uPlot-1.6.32.esm.js";
import { html, useEffect, useRef, useState } from "./vendor/htm-preact-3.1.1.module.js";
import { app, live, set } from "./app.js";
import { Field } from "./inspector.js";
import { get } from "./live.js";

const COLOURS = ["#0072B2", "#D55E00", "#009E73", "#8c5fa8", "#b8860b", "#56697a"];
const INKS = ["#222222", "#8a8a8a"];
const DASHES = [[], [8, 4], [2, 3], [8, 3, 2, 3]];
const ORBIT_TURNS = 4;
const most = { runs: 8, entries: 6 };
Object.assign(app, { runs: [], moved: {}, running: null, table: null, figure: null, count: 0 });

let again = false;

// Simulates the file as it is, with the parameters that were moved; driven as a run of a recording was, or shows such
// a run as it was measured. slid: the run takes the place of the last such. Returns whether there is a result.
export async function run({ kind = "run", slid = false, ...of } = {}) {
  if (app.running) {
    again ||= slid;
    return false;
  }
  const settings = kind === "measured" ? {} : moved();
  const working = { share: 0, id: null, slid };
  set({ running: working, said: "running" });
  const found = await live.ask({ kind, ...of, set: settings, started: (id) => (working.id = id) }, (share) => {
    working.share = share;
    set({});
  });
  set({ running: null });
  const done = found.kind === "result";
  if (done) keep(found, slid, settings);
  else set({ refused: found.problems ?? [], said: `no result: ${found.problems?.[0].what ?? "connection lost"}` });
  if (again) {
    again = false;
    run({ slid: true });
  }
  return done;
}

// The parameters that were moved, of those that there are.
const moved = () => Object.fromEntries(Object.entries(app.moved).filter(([name]) => parameters().some((one) => one.name === name)));

// Of the whole diagram: it is what runs, from inside of a sub-diagram, too.
const parameters = () => app.state.parameters ?? app.state.view?.parameters ?? [];

function keep(found, slid, settings) {
  const number = slid && app.runs[app.runs.length - 1]?.slid ? app.count : ++app.count;
  const others = slid ? app.runs.filter((each) => !each.slid) : app.runs;
  const values = found.compared && { ...found.compared, ...settings };
  const title = `${number}: ${[found.title, ...differing(values, others.find((one) => one.values)?.values)].join(", ")}`;
  const one = { ...found, number, slid, title, values, rows: found.values, shown: true, look: freeLook(others) };
  const bad = found.status === "finished" ? "" : `${found.status}: `;
  set({ refused: [], runs: [...others, one].slice(-most.runs), said: `${title}: ${bad}${found.message || "finished"}` });
}

// The colour and dash of a run, as a number: it keeps them while others come and go.
function freeLook(others) {
  const taken = others.map((each) => each.look);
  return COLOURS.map((_, k) => k).find((k) => !taken.includes(k)) ?? 0;
}

// Of entry j of a run: what was measured is dark.
const colour = (one, j) => (one.measured ? INKS[j % INKS.length] : COLOURS[j % COLOURS.length]);
const orbitColour = (one) => (one.measured ? INKS[0] : COLOURS[one.look % COLOURS.length]);
const dash = (one) => (one.measured ? [] : DASHES[one.look % DASHES.length]);

// In what a run differs from the first one, but for the speed, which its title says.
function differing(values, first) {
  if (!first || !values) return [];
  const names = [...new Set([...Object.keys(first), ...Object.keys(values)])].filter((name) => first[name] !== values[name] && name !== "speed");
  const words = names.slice(0, 2).map((name) => (name in values ? `${name} = ${values[name]}` : `without ${name}`));
  return names.length > 2 ? [...words, `${names.length - 2} more`] : words;
}

export async function analyse(what, recording = null) {
  const working = { share: 0, id: null };
  set({ running: working, said: `${what} ...` });
  const started = (id) => {
    working.id = id;
    set({});
  };
  const found = await live.ask({ kind: "analyse", what, recording, set: moved(), started }, (share) => {
    working.share = share;
    set({});
  });
  set({ running: null });
  if (found.kind === "table") {
    set({ refused: [], table: found, said: found.title });
    show(found.run, what, found.title);
  } else set({ refused: found.problems ?? [], said: `not done: ${found.problems?.[0].what ?? "connection lost"}` });
}

async function show(number, kind, title) {
  try {
    const answer = await get(`/api/figure/${number}/${kind}`);
    if (app.figure) URL.revokeObjectURL(app.figure.url);
    set({ figure: { url: URL.createObjectURL(await answer.blob()), title, file: `${kind}.svg` } });
  } catch (error) {
    set({ said: error.message });
  }
}

const QUANTITY = /^\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*)$/;

function Slider({ item }) {
  const given = typeof item.written === "number" ? [null, item.written, ""] : QUANTITY.exec(item.written ?? item.value);
  const [timer] = useState({ id: 0 });
  const now = app.moved[item.name];
  const item_ = { ...item, doc: `sets ${item.followers.join(", ")}` };
  const fixed = !!app.state.part || !item.field; // they stand in the file of the whole diagram
  if (!given) return html`<${Field} name=${item.field || item.name} label=${item.name} item=${item_} fixed=${fixed} />`;
  const value = Number(given[1]);
  const [low, high] = value === 0 ? [-1, 1] : [Math.min(0.5 * value, 1.5 * value), Math.max(0.5 * value, 1.5 * value)];
  const at = now === undefined ? value : Number(QUANTITY.exec(String(now))[1]);
  const slide = (event) => {
    const next = Number(Number(event.target.value).toPrecision(6));
    set({ moved: { ...app.moved, [item.name]: given[2] ? `${next} ${given[2]}` : next } });
    clearTimeout(timer.id);
    timer.id = setTimeout(() => run({ slid: true }), 80);
  };
  const more = html`<input type="range" data-testid=${`slider-${item.name}`} aria-label=${`${item.name}, for runs only`} min=${low} max=${high}
      step=${(high - low) / 200} value=${at} onInput=${slide} />
    <output class=${now === undefined ? "" : "moved"}>${now === undefined ? "as in the file" : now}</output>`;
  return html`<${Field} name=${item.field || item.name} label=${item.name} item=${item_} more=${more} fixed=${fixed} />`;
}

const MASTERS = ["gauss_seidel", "jacobi", "iterative", "waveform"];

// Co-simulation: FMUs, the parts that are named, and the rest exchange signals at communication points.
function CoSimulation({ busy }) {
  const [step, type] = useState("");
  const [master, choose] = useState(MASTERS[0]);
  const [parts, name] = useState("");
  const start = () => {
    const lists = parts.split(";").map((part) => part.split(",").map((one) => one.trim()).filter(Boolean)).filter((part) => part.length);
    run({ kind: "cosim", step, master, parts: lists });
  };
  const onKeyDown = (event) => event.key === "Enter" && step && start();
  return html`<details class="cosim"><summary>Co-simulation</summary>
    <div class="field"><label for="cosim-step">step</label><input id="cosim-step" placeholder="0.1 ms" value=${step} onInput=${(event) => type(event.target.value)} onKeyDown=${onKeyDown} /></div>
    <div class="field"><label for="cosim-master">master</label><select id="cosim-master" value=${master} onChange=${(event) => choose(event.target.value)}>
      ${MASTERS.map((one) => html`<option value=${one}>${one}</option>`)}</select></div>
    <div class="field"><label for="cosim-parts" title="Blocks that are a participant of their own; FMUs always are">parts</label>
      <input id="cosim-parts" placeholder="controller; amb, rotor" value=${parts} onInput=${(event) => name(event.target.value)} onKeyDown=${onKeyDown} /></div>
    <p class="actions"><button data-testid="cosim" disabled=${busy || !step || !app.state.valid} onClick=${start}>Co-simulate</button></p></details>`;
}

export function RunBar() {
  const any = Object.keys(moved()).length > 0;
  const busy = app.running && !app.running.slid; // a slider that moves leaves the bar as it is
  return html`<div class="runbar">
    <button class="main" data-testid="run" disabled=${busy || !app.state.valid} title="Simulate (p)" onClick=${() => run()}>Run</button>
    <button disabled=${busy} onClick=${() => analyse("modes")}>Modes</button>
    <button disabled=${busy} onClick=${() => analyse("campbell")}>Campbell</button>
    <button disabled=${busy} onClick=${() => analyse("periodic")}>Over speed</button>
    ${app.running
      ? html`<span class="working"><progress max="1" value=${app.running.share || undefined} aria-label="Progress" />
          ${app.running.id && html`<button onClick=${() => live.cancel(app.running.id)}>Cancel</button>`}</span>`
      : null}
    ${any ? html`<button onClick=${() => set({ moved: {} })}>Sliders back</button>` : null}
  </div>
  <details class="sliders" open><summary>Parameters of ${app.state.part ? app.state.top : "the diagram"}</summary>
    ${any ? html`<p class="moved">Sliders are for runs only: the file stays as it is.</p>` : null}
    ${parameters().map((item) => html`<${Slider} key=${item.name} item=${item} />`)}</details>
  <${CoSimulation} busy=${busy} />`;
}

function Kept() {
  if (!app.runs.length) return html`<p class="hint">Press Run, or move a slider. Results are kept here, side by side.</p>`;
  const change = (one, values) => set({ runs: app.runs.map((each) => (each === one ? { ...each, ...values } : each)) });
  return html`<ul class="kept">${app.runs.map((one) => html`<li key=${one.number}>
    <label><input type="checkbox" checked=${one.shown} onChange=${() => change(one, { shown: !one.shown })} />
      <svg class="dash" viewBox="0 0 40 8" aria-hidden="true"><path d="M0,4 h40" stroke=${orbitColour(one)} stroke-dasharray=${dash(one).join(" ")} /></svg>
      ${one.title}${one.status === "finished" ? "" : html` <b class="bad">${one.status}</b>`}</label>
    ${one.slid ? html`<button class="small" title="Keep this run when a slider moves again" onClick=${() => change(one, { slid: false })}>keep</button>` : null}
    <button class="small" onClick=${() => show(one.run, "spectrum", `Full spectrum, ${one.title}`)}>spectrum</button>
    <button class="small" onClick=${() => show(one.run, "overview", one.title)}>page</button>
    <button class="small" aria-label=${`Remove ${one.title}`} onClick=${() => set({ runs: app.runs.filter((each) => each !== one) })}>×</button>
    ${one.note ? html`<p class="hint">${one.note}</p>` : null}
    ${one.message ? html`<p class="wrong">${one.message}</p>` : null}</li>`)}</ul>`;
}

// The rows of a signal in the values of a run.
function rowsOf(one, name) {
  let first = 0;
  for (const signal of one.signals) {
    if (signal.name === name) return { signal, rows: one.rows.slice(first, first + signal.entries.length) };
    first += signal.entries.length;
  }
  return null;
}

const zoomed = new Map(); // signal -> [from, to] of its chart, kept when runs come and go

function Chart({ name, runs }) {
  const box = useRef(null);
  useEffect(() => {
    const parts = runs.map((one) => [one, rowsOf(one, name)]).filter((part) => part[1]);
    const unit = parts[0][1].signal.unit;
    const alike = parts.every(([one]) => one.time.length === parts[0][0].time.length && one.time[0] === parts[0][0].time[0] && one.time.at(-1) === parts[0][0].time.at(-1));
    const gaps = (row) => (row.every(Number.isFinite) ? row : Array.from(row, (value) => (Number.isFinite(value) ? value : null)));
    const tables = parts.map(([one, { rows }]) => [one.time, ...rows.slice(0, most.entries).map(gaps)]);
    const data = alike ? [tables[0][0], ...tables.flatMap((table) => table.slice(1))] : uPlot.join(tables);
    const series = parts.flatMap(([one, { signal }]) =>
      signal.entries.slice(0, most.entries).map((entry, j) => ({
        label: runs.length > 1 ? `${entry}, ${one.number}` : entry, // its title stands above, with the number
        stroke: colour(one, j),
        dash: dash(one),
        width: 1.2,
        spanGaps: !alike,
        value: (_, value) => (value === null || value === undefined ? "-" : value.toPrecision(5)),
      })),
    );
    const element = box.current;
    const chart = new uPlot({
      width: Math.max(element.clientWidth, 140),
      height: 190,
      title: `${name} [${unit}]`,
      scales: { x: { time: false, ...between(name, data[0]) } },
      axes: [{ label: "time [s]", labelSize: 18, size: 36 }, { size: 60 }],
      series: [{ label: "time [s]", value: (_, value) => (value === null || value === undefined ? "-" : value.toPrecision(6)) }, ...series],
      cursor: { sync: { key: "time" }, drag: { x: true, y: false } },
      legend: { live: true },
    }, data, element);
    const watch = new ResizeObserver(() => chart.setSize({ width: Math.max(element.clientWidth, 140), height: 190 }));
    watch.observe(element);
    return () => {
      watch.disconnect();
      const { min, max } = chart.scales.x;
      const whole = min <= data[0][0] && max >= data[0].at(-1);
      whole ? zoomed.delete(name) : zoomed.set(name, [min, max]);
      chart.destroy();
    };
  }, [name, runs.map((one) => `${one.run}:${one.title}`).join()]);
  return html`<div class="chart" data-testid="chart" role="img" aria-label=${`${name} over time`} ref=${box}></div>`;
}

// The part of the time that was zoomed to before, if there is some of it.
function between(name, time) {
  const [min, max] = zoomed.get(name) ?? [];
  return min < time.at(-1) && max > time[0] ? { min, max } : {};
}

function Orbit({ name, runs }) {
  const canvas = useRef(null);
  useEffect(() => drawOrbit(canvas.current, runs.map((one) => [one, rowsOf(one, name)]).filter((part) => part[1])));
  return html`<canvas class="orbit" data-testid="orbit" width="440" height="440" role="img" aria-label=${`Orbit of ${name}`} ref=${canvas}></canvas>`;
}

function drawOrbit(canvas, parts) {
  const pen = canvas.getContext("2d");
  const [size, edge] = [canvas.width, 64];
  const curves = parts.map(([one, { rows }]) => {
    const step = one.time[1] - one.time[0] || 1;
    const count = one.speed_rpm ? Math.ceil((ORBIT_TURNS * 60) / Math.abs(one.speed_rpm) / step) + 1 : Math.ceil(one.time.length / 5);
    return { one, xy: rows.map((row) => Array.from(row.slice(-Math.max(count, 2)))) };
  });
  const finite = (values) => values.filter(Number.isFinite);
  const all = [0, 1].map((axis) => finite(curves.flatMap((one) => one.xy[axis])));
  const ends = all.map((values) => [values.reduce((a, b) => Math.min(a, b), Infinity), values.reduce((a, b) => Math.max(a, b), -Infinity)]);
  const reach = Math.max(...ends.map(([low, high]) => high - low)) || 1;
  const middle = ends.map(([low, high]) => (low + high) / 2);
  const scale = (size - 2 * edge) / (1.08 * reach);
  const at = (x, y) => [size / 2 + 14 + (x - middle[0]) * scale, size / 2 - 14 - (y - middle[1]) * scale];
  pen.clearRect(0, 0, size, size);
  pen.font = "20px sans-serif";
  pen.fillStyle = "#222";
  pen.strokeStyle = "#ccc";
  pen.lineWidth = 1;
  const step = 10 ** Math.floor(Math.log10(reach)) * ([5, 2, 1].find((f) => reach / (10 ** Math.floor(Math.log10(reach)) * f) >= 2) ?? 0.5);
  for (const axis of [0, 1]) {
    for (let v = Math.ceil((middle[axis] - reach / 2) / step) * step; v <= middle[axis] + reach / 2 + 1e-9 * step; v += step) {
      const [x, y] = axis ? at(middle[0], v) : at(v, middle[1]);
      pen.beginPath();
      axis ? (pen.moveTo(edge, y), pen.lineTo(size - 12, y)) : (pen.moveTo(x, 12), pen.lineTo(x, size - edge));
      pen.stroke();
      pen.textAlign = axis ? "right" : "center";
      pen.fillText(String(Number(v.toPrecision(4))), axis ? edge - 6 : x, axis ? y + 7 : size - edge + 24);
    }
  }
  for (const { one, xy } of curves) {
    pen.strokeStyle = orbitColour(one);
    pen.setLineDash(dash(one).map((each) => 2 * each));
    pen.lineWidth = 2;
    pen.beginPath();
    xy[0].forEach((x, j) => Number.isFinite(x + xy[1][j]) && pen.lineTo(...at(x, xy[1][j])));
    pen.stroke();
    const last = at(xy[0].at(-1) ?? 0, xy[1].at(-1) ?? 0);
    pen.setLineDash([]);
    pen.fillStyle = orbitColour(one);
    pen.beginPath();
    pen.arc(...last, 6, 0, 7);
    pen.fill();
  }
  const unit = parts[0][1].signal.unit;
  pen.fillStyle = "#222";
  pen.textAlign = "center";
  pen.fillText(`x [${unit}]`, size / 2, size - 8);
  pen.save();
  pen.translate(18, size / 2);
  pen.rotate(-Math.PI / 2);
  pen.fillText(`y [${unit}]`, 0, 0);
  pen.restore();
}

// A table as a file that other programs read.
function asCsv({ columns, rows }) {
  const quoted = (one) => (/[",\n]/.test(String(one)) ? `"${String(one).replaceAll('"', '""')}"` : String(one));
  return `data:text/csv;charset=utf-8,${encodeURIComponent([columns, ...rows].map((row) => row.map(quoted).join(",")).join("\r\n"))}`;
}

function Figure() {
  const { figure, table } = app;
  if (!figure && !table) return null;
  const close = () => {
    if (figure) URL.revokeObjectURL(figure.url);
    set({ figure: null, table: null });
  };
  return html`<div class="figure"><p class="actions"><b>${figure?.title ?? table?.title}</b>
      ${figure ? html`<a href=${figure.url} download=${figure.file}>Save as SVG</a>` : null}
      ${table ? html`<a href=${asCsv(table)} download="table.csv">Save the table as CSV</a>` : null}<button class="small" onClick=${close}>Close</button></p>
    ${figure ? html`<img data-testid="figure" src=${figure.url} alt=${figure.title} />` : null}
    ${table ? html`<table><thead><tr>${table.columns.map((one) => html`<th>${one}</th>`)}</tr></thead>
      <tbody>${table.rows.map((row) => html`<tr>${row.map((one) => html`<td>${one}</td>`)}</tr>`)}</tbody></table>` : null}
  </div>`;
}

export function Results() {
  const runs = app.runs.filter((one) => one.shown);
  const signals = new Map(runs.flatMap((one) => one.signals.map((signal) => [signal.name, signal])));
  return html`<${Kept} /><${Figure} />
    ${[...signals.values()].map((signal) => html`<div class="signal" key=${signal.name}>
      <${Chart} name=${signal.name} runs=${runs} />
      ${signal.two_axis ? html`<${Orbit} name=${signal.name} runs=${runs} />` : null}</div>`)}`;
}
