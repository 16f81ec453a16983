/** Recorded runs with their reports; what can be played goes to the replay panel (panels/replay.js). A report opens in a tab of its own; the browser's ticket lets only who is logged in see it. */
import {add, button, clear, setText} from "../dom.js";
import {readListing} from "../runs/listing.js";

const LISTING = "private/runs.json";

/**
 * Make the panel.
 *
 * @param {Element} parent
 * @param {object} store see store.js
 * @param {object} connection see connection.js
 * @param {Function} texts see texts.js
 * @param {object} [means] for tests: `fetch`
 */
export function make(parent, store, connection, texts, means = {}) {
  const fetchList = means.fetch ?? ((path) => fetch(path));
  let turn = 0;
  const told = add(parent, "p", {className: "runs-told", role: "status"});
  const refresh = button(parent, texts("runs.refresh"), load);
  const table = add(parent, "table", {className: "runs-list", hidden: true});
  const head = add(add(table, "thead"), "tr");
  add(head, "th", {text: texts("runs.name"), scope: "col"});
  add(head, "th", {text: texts("runs.time"), scope: "col"});
  add(head, "th", {text: texts("runs.replay"), scope: "col"});
  const body = add(table, "tbody");

  async function load() {
    const mine = (turn += 1);
    if (connection.state !== "connected") {
      fail(texts("runs.not_connected"));
      return;
    }
    setText(told, texts("runs.loading"));
    refresh.disabled = true;
    try {
      const answer = await fetchList(LISTING);
      const runs = answer.ok ? readListing(await answer.json()) : null;
      // another was asked for meanwhile
      if (mine !== turn) return;
      if (runs === null) fail(why(answer.status));
      else showRuns(runs);
    } catch (error) {
      // no network, or no list
      if (mine === turn) fail(texts("runs.failed", {why: error.message}));
    } finally {
      if (mine === turn) refresh.disabled = false;
    }
  }

  function why(status) {
    if (status === 403) return texts("runs.forbidden");
    if (status === 404) return texts("runs.none_served");
    return texts("runs.failed", {why: String(status)});
  }

  function fail(sentence) {
    clear(body);
    table.hidden = true;
    refresh.disabled = false;
    setText(told, sentence);
  }

  function showRuns(runs) {
    clear(body);
    table.hidden = runs.length === 0;
    setText(told, runs.length === 0 ? texts("runs.empty") : "");
    for (const run of runs) {
      const row = add(body, "tr");
      const cell = add(row, "td");
      add(cell, "a", {href: run.href, target: "_blank", rel: "noopener", text: run.name});
      add(row, "td", {text: run.time.toLocaleString(texts.language)});
      const last = add(row, "td");
      if (run.replay === "") add(last, "span", {className: "runs-none", text: texts("runs.no_replay")});
      else button(last, texts("runs.play"), () => play(run), {"aria-label": texts("runs.play_of", {run: run.name})});
    }
  }

  function play({name, href, replay}) {
    // the picture has a place for a recording once a robot was heard
    if (store.selected === "") setText(told, texts("runs.no_robot"));
    else store.set("replay_run", store.selected, {run: name, href: replay, report: href});
  }

  const isOpen = () => parent.tab?.isOpen() ?? true;
  parent.tab?.onOpen(load);
  store.on("connection", (_, state) => {
    if (state !== "connected") {
      turn += 1;
      fail(texts("runs.not_connected"));
    } else if (isOpen()) {
      load();
    }
  });
  setText(told, texts("runs.not_connected"));
  if (connection.state === "connected" && (isOpen())) load();
}
