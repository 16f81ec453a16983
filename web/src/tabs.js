/**
 * The panels that share one place beside the picture: a tab for each. Where the screen is wide enough the first stands beside the
 * others (style.css), and has no tab there.
 *
 * A panel's element has `tab`: `isOpen()`, `open()`, `offer(is)` (whether there is anything in it), `mark(text)` (a number on its tab), and
 * `onOpen(listener)`.
 */
import {add, button, setText} from "./dom.js";

/**
 * Make the tabs.
 *
 * @param {Element} parent
 * @param {Function} texts
 * @param {string[]} names of the panels, in their order; the first is open at first
 * @param {(name: string) => Element} makePanel
 * @returns {Object<string, Element>} the panels by name
 */
export function makeTabs(parent, texts, names, makePanel) {
  const list = add(parent, "div", {className: "tabs", role: "tablist", "aria-label": texts("page.tabs")});
  const [first] = names;
  const panels = {};
  const tabs = {};
  let chosen = first;
  // what stands beside the first where both have room
  let beside = names[1] ?? first;

  const show = () => {
    for (const name of names) {
      tabs[name].setAttribute("aria-selected", String(name === chosen));
      tabs[name].setAttribute("tabindex", name === chosen ? "0" : "-1");
      panels[name].classList.toggle("is-chosen", name === chosen);
      panels[name].classList.toggle("is-beside", name === beside && name !== first);
    }
  };
  const open = (name) => {
    if (tabs[name].hidden) return;
    chosen = name;
    if (name !== first) beside = name;
    show();
    for (const listener of panels[name].tab.listeners) listener();
  };
  const usable = () => names.filter((name) => !tabs[name].hidden);

  for (const name of names) {
    tabs[name] = button(list, "", () => open(name), {role: "tab", id: `tab-${name}`, className: `tab tab-${name}`, "aria-controls": name});
    add(tabs[name], "span", {text: texts(`page.tab.${name}`)});
    const badge = add(tabs[name], "span", {className: "tab-badge", hidden: true});
    panels[name] = makePanel(name);
    panels[name].setAttribute("role", "tabpanel");
    panels[name].setAttribute("aria-labelledby", `tab-${name}`);
    panels[name].classList.add("panel");
    panels[name].tab = {
      listeners: [],
      isOpen: () => panels[name].getClientRects?.().length !== 0,
      open: () => open(name),
      onOpen: (listener) => panels[name].tab.listeners.push(listener),
      mark(text) {
        badge.hidden = text === "";
        setText(badge, text);
      },
      offer(is) {
        tabs[name].hidden = !is;
        if (is) return;
        if (beside === name) beside = usable().find((each) => each !== first) ?? first;
        if (chosen === name) open(first);
        else show();
      },
    };
  }
  list.addEventListener("keydown", (event) => {
    const step = {ArrowRight: 1, ArrowLeft: -1}[event.key];
    if (step === undefined) return;
    const there = usable();
    const next = there[(there.indexOf(chosen) + step + there.length) % there.length];
    open(next);
    tabs[next].focus();
  });
  show();
  return panels;
}
