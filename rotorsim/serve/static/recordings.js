// Recordings below the folder of the diagram: beside it, identified from, diagnosed; what was found, and its repair.

import { html, useEffect, useState } from "./vendor/htm-preact-3.1.1.module.js";
import { app, edit, live, readOnly, set } from "./app.js";
import { get } from "./live.js";
import { analyse, run } from "./runs.js";

Object.assign(app, { recordings: null, recording: "", recorded_run: "", finding: null, found: null });

const held = (name) => name.endsWith("_hold_out"); // scores what others have led to

export async function listRecordings() {
  const answer = await get("/api/recordings");
  const { recordings } = await answer.json();
  const names = recordings.map((one) => one.name).filter((name) => !held(name));
  set({ recordings, recording: names.includes(app.recording) ? app.recording : (names[0] ?? "") });
}

// The recording that is chosen: name, kind, runs.
export const chosenRecording = () => app.recordings?.find((one) => one.name === app.recording);

// Shows a run as it was measured, and the diagram driven as it was.
async function compare() {
  const one = chosenRecording();
  if (one.kind === "orders") return find("beside");
  const of = { recording: one.name, run: one.runs.includes(app.recorded_run) ? app.recorded_run : (one.runs[0] ?? null) };
  if (await run({ kind: "measured", ...of })) await run(of);
}

async function find(verb) {
  const working = { share: 0, text: "", id: null };
  set({ finding: working, said: `${verb} ${app.recording} ...` });
  const asked = { kind: "find", verb, recording: app.recording, started: (id) => (working.id = id) };
  const found = await live.ask(asked, (share, data) => {
    Object.assign(working, { share, text: data.text ?? "" });
    set({});
  });
  set({ finding: null });
  if (found.kind === "found") set({ found, said: `${found.title}: done` });
  else set({ refused: found.problems ?? [], said: `not done: ${found.problems?.[0].what ?? "connection lost"}` });
}

export function Recordings() {
  useEffect(() => {
    listRecordings();
  }, [app.state.file]);
  const names = (app.recordings ?? []).map((one) => one.name).filter((name) => !held(name));
  if (!names.length) {
    return html`<details class="recordings"><summary>Recordings</summary>
      <p class="hint">None below the folder of the diagram: <code>rotorsim record</code> simulates one, docs/recordings.md says how measured ones are described.</p>
      <button class="small" onClick=${listRecordings}>Look again</button></details>`;
  }
  const busy = !!app.finding || !app.state.valid;
  const runs = chosenRecording()?.runs ?? [];
  return html`<details class="recordings" open><summary>Recordings</summary>
    <p class="actions"><select aria-label="Recording" data-testid="recording" value=${app.recording} onChange=${(event) => set({ recording: event.target.value })}>
      ${names.map((name) => html`<option value=${name}>${name}</option>`)}</select>
      <button class="small" title="Look again for recordings" onClick=${listRecordings}>↻</button></p>
    ${runs.length > 1
      ? html`<p class="actions"><label>run <select aria-label="Run of the recording" data-testid="recorded-run" value=${runs.includes(app.recorded_run) ? app.recorded_run : runs[0]} onChange=${(event) => set({ recorded_run: event.target.value })}>
          ${runs.map((name) => html`<option value=${name}>${name}</option>`)}</select></label></p>`
      : null}
    <p class="actions"><button disabled=${busy || !!app.running} data-testid="compare" title="The run as it was measured, and the diagram driven as it was" onClick=${compare}>Compare</button>
      <button disabled=${busy || !!app.running} data-testid="over-speed" title="Settled motion over the speed, with the harmonics of the runs" onClick=${() => analyse("periodic", app.recording)}>Over speed</button>
      <button disabled=${busy} title="Estimate the free parameters" onClick=${() => find("identify")}>Identify</button>
      <button disabled=${busy} data-testid="diagnose" title="Where they differ, and what physics is missing" onClick=${() => find("diagnose")}>Diagnose</button></p>
    ${app.finding ? html`<p class="actions"><progress max="1" value=${app.finding.share || undefined} aria-label="Progress" />
      <button onClick=${() => live.cancel(app.finding.id)}>Cancel</button></p><p class="hint">${app.finding.text}</p>` : null}</details>`;
}

function Picture({ outcome, name }) {
  const [url, show] = useState("");
  useEffect(() => {
    let made = "";
    get(`/api/outcome/${outcome}/${name}`).then(async (answer) => show((made = URL.createObjectURL(await answer.blob()))));
    return () => URL.revokeObjectURL(made);
  }, [outcome, name]);
  return url && html`<figure><img src=${url} alt=${name} /><figcaption><a href=${url} download=${name}>${name}</a></figcaption></figure>`;
}

export function Found() {
  const found = app.found;
  if (!found) return null;
  const apply = () => edit([{ op: "patch", changes: found.changes }], { base: found.sha, title: `apply ${found.title}` });
  return html`<div class="figure" data-testid="found"><p class="actions"><b>${found.title}</b>
      <button class="small" onClick=${() => set({ found: null })}>Close</button></p>
    ${found.changes.length
      ? html`<details open=${!found.report} class="repair"><summary data-testid="repair">What the ${found.report ? "repaired" : "identified"} diagram changes: ${found.words.length} entries</summary>
          <ul>${found.words.map((one) => html`<li><code>${one}</code></li>`)}</ul>
          ${app.state.part ? html`<p class="hint">It is applied in ${app.state.top}: go there first.</p>` : readOnly() ? null : html`<button data-testid="apply" onClick=${apply}>Apply to ${app.state.file}, as one step</button>`}</details>`
      : null}
    <details open=${!found.report}><summary>In words</summary><pre>${found.text}</pre></details>
    ${found.report
      ? html`<iframe data-testid="report" sandbox="" src=${found.report} title=${`Report, ${found.title}`}></iframe>`
      : found.figures.map((name) => html`<${Picture} key=${name} outcome=${found.outcome} name=${name} />`)}
  </div>`;
}
