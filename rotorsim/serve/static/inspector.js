// What is selected: a block with its values, a wire, or the diagram with its parameters.

import { html, useEffect, useRef, useState } from "./vendor/htm-preact-3.1.1.module.js";
import { app, block, chosen, edit, enter, live, readOnly, select, set } from "./app.js";
import { dissolve, duplicate, editable, group, remove } from "./selection.js";

const text = (value) => (value === null || value === undefined ? "" : typeof value === "string" ? value : JSON.stringify(value));

// What a text means: JSON where it is some (numbers, lists, true), else the text, such as "2 kg".
export function meant(given) {
  try {
    const value = JSON.parse(given);
    return JSON.stringify(value).includes("null") ? given.trim() : value; // null, and numbers that JSON cannot hold
  } catch {
    return given.trim();
  }
}

// A name that may be folded behind its underlines.
const broken = (name) => name.split("_").map((part, k) => (k ? html`_<wbr />${part}` : part));

// A field of a value: checked while it is typed, written when it is left or Enter is pressed. Its key is its name: what
// is typed is never cleared for another name, since effects run after painting, and so after the first key.
export function Field({ name, label, item, more, fixed }) {
  const shown = item.written !== null && item.written !== undefined ? text(item.written) : "";
  const [typed, type] = useState(null);
  const [wrong, say] = useState(null);
  const sent = useRef(null); // the text that is being written, or was refused
  useEffect(() => {
    if (typed === null || typed === shown || typed === "") return say(null);
    const timer = setTimeout(async () => {
      const found = await live.ask({ kind: "value", name, value: meant(typed) });
      say(found.problem ? found : null);
    }, 250);
    return () => clearTimeout(timer);
  }, [typed]);
  const commit = async () => {
    if (typed === null || typed === shown) return type(null);
    if (typed === "" && item.required !== false) return type(null);
    if (typed === sent.current) return;
    sent.current = typed;
    const base = app.editing?.name === name ? app.editing.base : undefined;
    const done = await edit([{ op: "set", name, value: typed === "" ? null : meant(typed) }], { base });
    if (done || app.dialog?.kind === "conflict") type(null);
    if (done || !app.refused.length) sent.current = null;
  };
  const onInput = (event) => {
    if (typed === null) app.editing = { name, base: app.sha }; // what was seen when the change began
    sent.current = null;
    type(event.target.value);
  };
  const id = `field-${name}`;
  return html`<div class="field">
    <label for=${id} title=${item.doc}>${broken(label)}</label>
    <input id=${id} data-testid=${`param-${name}`} value=${typed ?? shown} placeholder=${item.value} disabled=${readOnly() || fixed}
      aria-invalid=${!!wrong} aria-describedby=${wrong ? `${id}-wrong` : undefined}
      onBlur=${commit} onInput=${onInput}
      onKeyDown=${(event) => {
        if (event.key === "Enter") commit();
        if (event.key === "Escape") type(null);
      }} />
    <span class="unit">${item.unit === "1" || item.unit === "any" || /^$|[a-z%]/i.test(typed ?? shown) ? "" : item.unit}</span>
    <${Default} name=${name} item=${item} />
    ${more}
    ${wrong ? html`<p class="wrong" id=${`${id}-wrong`} data-testid="param-error">${wrong.problem}${wrong.hint && ` (${wrong.hint})`}</p>` : null}
    ${item.follows ? html`<p class="follows">follows the parameter ${item.follows} of the diagram: ${item.value}</p>` : null}
  </div>`;
}

function Default({ name, item }) {
  if (item.written === null || item.required !== false || readOnly()) return null;
  const back = () => edit([{ op: "set", name, value: null }]);
  return html`<button class="small" title="Back to the default" aria-label=${`${name}: back to the default`} onClick=${back}>↺</button>`;
}

function Choice({ name, item }) {
  const value = String(item.written ?? item.value).toLowerCase();
  const chosen = item.choices.findIndex((one) => String(one).toLowerCase() === value);
  const choose = async ({ target }) => {
    if (!(await edit([{ op: "set", name, value: item.choices[target.selectedIndex] }]))) target.selectedIndex = chosen;
  };
  return html`<div class="field"><label for=${`field-${name}`} title=${item.doc}>${broken(item.name)}</label>
    <select id=${`field-${name}`} data-testid=${`param-${name}`} disabled=${readOnly()} onChange=${choose}>
      ${item.choices.map((one, k) => html`<option selected=${k === chosen}>${String(one)}</option>`)}
    </select><span></span><${Default} name=${name} item=${item} /></div>`;
}

// Selects a wire from its block, and goes to the button that cuts it: so wires are reached without a mouse.
function toWire(wire) {
  select({ wire: [wire.source, wire.target] });
  requestAnimationFrame(() => (document.querySelector("aside [data-testid=remove]") ?? document.querySelector("aside button"))?.focus());
}

function Ports({ title, one, side }) {
  const ports = one[side];
  if (!ports.length) return null;
  const [own, other] = side === "inputs" ? ["target", "source"] : ["source", "target"];
  const { wires, record } = app.state.view;
  const recorder = (signal) => {
    const on = record.includes(signal);
    const change = () => edit([{ op: "record", signal, on: !on }]);
    return html`<button class="small" aria-pressed=${on} onClick=${change} aria-label=${`${on ? "do not record" : "record"} ${signal}`}>${on ? "recorded ✓" : "record"}</button>`;
  };
  const outside = app.state.part || app.state.view.blocks.some((each) => [...each.inputs, ...each.outputs].some((port) => port.exposed.length));
  const exposer = (name, port) => {
    const [on, end] = [port.exposed.length > 0, port.exposed[0]?.[1] ?? name];
    const change = () => edit([{ op: "port", side, end, on: !on }]);
    return html`<button class="small" aria-pressed=${on} title="Whether it is a port of this diagram" onClick=${change} aria-label=${`port of the diagram: ${name}`}>${on ? `port ${port.exposed[0][0]} ✓` : "port"}</button>`;
  };
  return html`<h3>${title}</h3><ul class="ports">${ports.map((port) => {
    const name = `${one.name}.${port.name}`;
    const own_wires = wires.filter((wire) => wire[own].replace(/\[.*$/, "") === name);
    return html`<li key=${port.name}><b>${port.name}</b> ${port.unit === "1" ? "" : port.unit} <span class="shape">${port.shape}</span>
      ${own_wires.length || port.exposed.length ? null : html` <span class="shape">${port.optional ? "not wired, may stay so" : "not wired"}</span>`}
      ${side === "outputs" && one.editable && !readOnly() && !app.state.part ? recorder(name) : null}
      ${outside && one.editable && !readOnly() ? exposer(name, port) : null}
      ${own_wires.map((wire) => html`<button class="link" title="To the wire" onClick=${() => toWire(wire)}>${other === "source" ? "from" : "to"} ${wire[other]}</button>`)}</li>`;
  })}</ul>`;
}

// What is done with a sub-diagram, or with the one that a block is a part of.
function PartActions({ one }) {
  const part = one.closed ? one.name : one.part;
  if (!part) return null;
  const below = app.state.part ? `${app.state.part}/${part}` : part;
  const show = (open) => live.ask({ kind: "part", block: part, open });
  return html`${one.closed ? null : html`<p>It is a part of the sub-diagram ${part}, which has a file of its own.</p>`}
    <p class="actions">${one.closed
      ? html`<button data-testid="open-part" title="Show its blocks here (o)" onClick=${() => show(true)}>Open</button>`
      : html`<button data-testid="close-part" onClick=${() => show(false)}>Close ${part}</button>`}
    <button data-testid="enter-part" title="Edit its file (e)" onClick=${() => enter(below)}>Enter${one.closed ? "" : ` ${part}`}</button>
    ${one.closed && one.editable && !readOnly() ? html`<button data-testid="dissolve" title="Put its blocks here in its place (x)" onClick=${() => dissolve(part)}>Dissolve</button>` : null}</p>`;
}

function OfSeveral({ names }) {
  const blocks = editable();
  return html`<h2>${names.length} blocks</h2>
    ${!readOnly() && blocks.length
      ? html`<p class="actions"><button data-testid="group" title="Into a sub-diagram (g)" onClick=${group}>Group</button>
          <button onClick=${duplicate}>Duplicate</button><button data-testid="remove" onClick=${remove}>Remove</button></p>`
      : null}
    <ul class="ports">${names.map((name) => html`<li key=${name}><button class="link" onClick=${() => select({ block: name })}>${name}</button></li>`)}</ul>`;
}

function OfBlock({ one }) {
  const fields = (items) =>
    items.map((item) => {
      const name = `${one.name}.${item.name}`;
      const is_bool = !item.choices && /^(True|False)$/.test(item.value);
      if (is_bool) return html`<${Choice} key=${name} name=${name} item=${{ ...item, choices: [false, true] }} />`;
      return item.choices ? html`<${Choice} key=${name} name=${name} item=${item} />` : html`<${Field} key=${name} name=${name} label=${item.name} item=${item} />`;
    });
  return html`<h2>${one.name}</h2><p class="kind">${one.kind}</p><p>${one.summary}</p>
    <${PartActions} one=${one} />
    ${!readOnly() && one.editable
      ? html`<p class="actions"><button data-testid="rename" onClick=${() => set({ dialog: { kind: "rename", block: one.name } })}>Rename</button>
          <button data-testid="swap" onClick=${() => set({ dialog: { kind: "swap", block: one.name } })}>Swap</button>
          <button onClick=${() => set({ dialog: { kind: "wire", block: one.name } })}>Wire</button>
          <button data-testid="group" title="Into a sub-diagram (g)" onClick=${group}>Group</button>
          <button onClick=${duplicate}>Duplicate</button>
          <button data-testid="remove" onClick=${remove}>Remove</button></p>`
      : null}
    ${one.parameters.length ? html`<h3>Parameters</h3>${fields(one.parameters)}` : null}
    ${one.options.length ? html`<h3>Options</h3>${fields(one.options)}` : null}
    <${Ports} title="Inputs" one=${one} side="inputs" /><${Ports} title="Outputs" one=${one} side="outputs" />`;
}

function OfWire({ wire }) {
  const recorded = app.state.view.record.includes(wire.source);
  const record = () => edit([{ op: "record", signal: wire.source, on: !recorded }]);
  const end = (text) => html`<button class="link" title="To the block" onClick=${() => select({ block: text.split(/\.(?=[^.]*$)/)[0] })}>${text}</button>`;
  return html`<h2>Wire</h2><p>${end(wire.source)} to ${end(wire.target)}</p>
    <p>unit ${wire.unit}, ${wire.shape === "scalar" ? "a scalar" : `shape ${wire.shape}`}</p>
    ${readOnly() ? null : html`<p class="actions"><button data-testid="remove" onClick=${remove}>Cut</button>
      ${app.state.part ? null : html`<button onClick=${record}>${recorded ? "Do not record" : "Record"} ${wire.source}</button>`}</p>`}`;
}

export function Inspector() {
  const view = app.state.view;
  const one = block(app.selected?.block);
  if (chosen().length > 1) return html`<${OfSeveral} names=${chosen()} />`;
  if (one) return html`<${OfBlock} key=${one.name} one=${one} />`;
  const [source, target] = app.selected?.wire ?? [];
  const wire = source && view?.wires.find((each) => each.source === source && each.target === target);
  if (wire) return html`<${OfWire} wire=${wire} />`;
  return html`<h2>${view?.name}</h2><p>${view?.description}</p><p class="hint">Select a block or a wire.</p>
    ${app.state.part && view?.parameters.length
      ? html`<h3>Parameters, where they are not given outside</h3>${view.parameters.map((item) => html`<${Field} key=${item.name} name=${item.name} label=${item.name} item=${item} />`)}`
      : null}
    ${app.state.part ? null : html`<h3>Recorded</h3><ul class="ports">${view?.record.map((signal) => html`<li>${signal}</li>`)}</ul>`}`; // what is recorded, the whole diagram says
}
