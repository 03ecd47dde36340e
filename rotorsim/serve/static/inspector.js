// What is selected: a block with its values, a wire, or the diagram with its parameters.

import { html, useEffect, useState } from "./vendor/htm-preact-3.1.1.module.js";
import { app, block, duplicate, edit, live, readOnly, remove, set } from "./app.js";

const text = (value) => (value === null || value === undefined ? "" : typeof value === "string" ? value : JSON.stringify(value));

// What a text means: JSON where it is some (numbers, lists, true), else the text, such as "2 kg".
export function meant(given) {
  try {
    return JSON.parse(given);
  } catch {
    return given.trim();
  }
}

// A name that may be folded behind its underlines.
const broken = (name) => name.split("_").map((part, k) => (k ? html`_<wbr />${part}` : part));

// A field of a value: checked while it is typed, written when it is left or Enter is pressed.
export function Field({ name, label, item, more }) {
  const shown = item.written !== null && item.written !== undefined ? text(item.written) : "";
  const [typed, type] = useState(null);
  const [wrong, say] = useState(null);
  useEffect(() => {
    type(null);
    say(null);
  }, [name]);
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
    const base = app.editing?.name === name ? app.editing.base : undefined;
    await edit([{ op: "set", name, value: typed === "" ? null : meant(typed) }], { base });
    if (app.editing?.name === name) app.editing.base = app.sha;
    if (!app.refused.length) type(null);
  };
  const id = `field-${name}`;
  return html`<div class="field">
    <label for=${id} title=${item.doc}>${broken(label)}</label>
    <input id=${id} data-testid=${`param-${name}`} value=${typed ?? shown} placeholder=${item.value} disabled=${readOnly()}
      aria-invalid=${!!wrong} aria-describedby=${wrong ? `${id}-wrong` : undefined}
      onFocus=${() => (app.editing = { name, base: app.sha })} onBlur=${commit} onInput=${(event) => type(event.target.value)}
      onKeyDown=${(event) => {
        if (event.key === "Enter") commit();
        if (event.key === "Escape") type(null);
      }} />
    <span class="unit">${item.unit === "1" || item.unit === "any" || /[a-z%]/i.test(typed ?? shown) ? "" : item.unit}</span>
    ${item.written !== null && item.required === false && !readOnly()
      ? html`<button class="small" title="Back to the default" aria-label=${`${name}: back to the default`} onClick=${() => edit([{ op: "set", name, value: null }])}>↺</button>`
      : null}
    ${more}
    ${wrong ? html`<p class="wrong" id=${`${id}-wrong`} data-testid="param-error">${wrong.problem}${wrong.hint && ` (${wrong.hint})`}</p>` : null}
    ${item.follows ? html`<p class="follows">follows the parameter ${item.follows} of the diagram: ${item.value}</p>` : null}
  </div>`;
}

function Choice({ name, item }) {
  const value = item.written ?? item.value;
  const choose = (event) => edit([{ op: "set", name, value: item.choices[event.target.selectedIndex] }]);
  return html`<div class="field"><label for=${`field-${name}`} title=${item.doc}>${broken(item.name)}</label>
    <select id=${`field-${name}`} data-testid=${`param-${name}`} disabled=${readOnly()} onChange=${choose}>
      ${item.choices.map((one) => html`<option selected=${String(one) === String(value)}>${String(one)}</option>`)}
    </select></div>`;
}

function Ports({ title, ports }) {
  if (!ports.length) return null;
  return html`<h3>${title}</h3><ul class="ports">${ports.map(
    (one) => html`<li><b>${one.name}</b> ${one.unit === "1" ? "" : one.unit} <span class="shape">${one.shape}</span> ${one.wired ? "" : "not wired"}</li>`,
  )}</ul>`;
}

function OfBlock({ one }) {
  const fields = (items) =>
    items.map((item) => {
      const name = `${one.name}.${item.name}`;
      return item.choices ? html`<${Choice} key=${name} name=${name} item=${item} />` : html`<${Field} key=${name} name=${name} label=${item.name} item=${item} />`;
    });
  return html`<h2>${one.name}</h2><p class="kind">${one.kind}</p><p>${one.summary}</p>
    ${one.editable ? null : html`<p>It is part of a sub-diagram, which has a file of its own.</p>`}
    ${!readOnly() && one.editable
      ? html`<p class="actions"><button data-testid="rename" onClick=${() => set({ dialog: { kind: "rename", block: one.name } })}>Rename</button>
          <button data-testid="swap" onClick=${() => set({ dialog: { kind: "swap", block: one.name } })}>Swap</button>
          <button onClick=${() => set({ dialog: { kind: "wire", block: one.name } })}>Wire</button>
          <button onClick=${duplicate}>Duplicate</button>
          <button data-testid="remove" onClick=${remove}>Remove</button></p>`
      : null}
    ${one.parameters.length ? html`<h3>Parameters</h3>${fields(one.parameters)}` : null}
    ${one.options.length ? html`<h3>Options</h3>${fields(one.options)}` : null}
    <${Ports} title="Inputs" ports=${one.inputs} /><${Ports} title="Outputs" ports=${one.outputs} />`;
}

function OfWire({ wire }) {
  const recorded = app.state.view.record.includes(wire.source);
  const record = () => edit([{ op: "record", signal: wire.source, on: !recorded }]);
  return html`<h2>Wire</h2><p><b>${wire.source}</b> to <b>${wire.target}</b></p>
    <p>unit ${wire.unit}, ${wire.shape === "scalar" ? "a scalar" : `shape ${wire.shape}`}</p>
    ${readOnly() ? null : html`<p class="actions"><button data-testid="remove" onClick=${remove}>Cut</button>
      <button onClick=${record}>${recorded ? "Do not record" : "Record"} ${wire.source}</button></p>`}`;
}

export function Inspector() {
  const view = app.state.view;
  const one = block(app.selected?.block);
  if (one) return html`<${OfBlock} key=${one.name} one=${one} />`;
  const [source, target] = app.selected?.wire ?? [];
  const wire = source && view?.wires.find((each) => each.source === source && each.target === target);
  if (wire) return html`<${OfWire} wire=${wire} />`;
  return html`<h2>${view?.name}</h2><p>${view?.description}</p><p class="hint">Select a block or a wire.</p>
    <h3>Recorded</h3><ul class="ports">${view?.record.map((signal) => html`<li>${signal}</li>`)}</ul>`;
}
