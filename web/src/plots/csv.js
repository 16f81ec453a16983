// A history as CSV: one row per sample, then one per mark, in the order of time. Numbers have a point, fields a comma (RFC 4180).

const DECIMALS = 6;

// A text that no table program takes for a formula.
export function field(text) {
  const plain = /^[=+\-@\t\r]/.test(text) ? `'${text}` : text;
  return /[",\r\n]/.test(plain) ? `"${plain.replaceAll('"', '""')}"` : plain;
}

// Return the rows of a history since `begin` [s, this page's clock] as parts of a text; `seconds` are counted from there.
export function csv(history, begin) {
  const {ring, marks, names} = history;
  const heads = ["seconds", "stamp_s"];
  names.forEach((name, joint) => heads.push(`error_${name}_${history.unit(joint) === "mm" ? "mm" : "deg"}`));
  heads.push("round_trip_ms", "late_replies", "fault", "fault_text");
  const rows = [heads.map(field).join(",")];
  let mark = 0;
  while (mark < marks.size && marks.at(mark).time < begin) mark += 1;
  for (let number = ring.firstSince(begin); number < ring.size; number += 1) {
    const time = ring.time(number);
    for (; mark < marks.size && marks.at(mark).time <= time; mark += 1) rows.push(markRow(marks.at(mark), begin, names.length));
    const cells = [number_(time - begin), number_(ring.stamp(number))];
    for (let column = 0; column < ring.columns; column += 1) cells.push(number_(ring.value(number, column)));
    rows.push(`${cells.join(",")},,`);
  }
  for (; mark < marks.size; mark += 1) rows.push(markRow(marks.at(mark), begin, names.length));
  return `${rows.join("\r\n")}\r\n`;
}

function markRow(mark, begin, joints) {
  return `${number_(mark.time - begin)},${",".repeat(joints + 3)}${field(mark.kind)},${field(mark.text)}`;
}

function number_(value) {
  return Number.isNaN(value) ? "" : String(Number(value.toFixed(DECIMALS)));
}
