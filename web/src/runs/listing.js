// The list of recorded runs, as the console gives it. Pure; what is read is checked, because a link is made of it.

const MOST = 200;

// Return [{name, time: Date, href, replay}], the newest first, of the parsed `runs.json`; an Error for anything else. `replay` is the address of what
// can be played of it, "" where there is none.
export function readListing(document) {
  if (typeof document !== "object" || document === null || !Array.isArray(document.runs)) throw new Error("no list of runs");
  return document.runs
    .slice(0, MOST)
    .filter(isRun)
    .sort((one, other) => other.stamp - one.stamp)
    .map(({name, stamp, report, replay}) => ({name, time: new Date(stamp * 1000), href: address(report), replay: isPath(replay) ? address(replay) : ""}));
}

function isRun(run) {
  return (
    typeof run === "object" &&
    run !== null &&
    typeof run.name === "string" &&
    typeof run.stamp === "number" &&
    Number.isFinite(new Date(run.stamp * 1000).getTime()) &&
    isPath(run.report)
  );
}

function isPath(value) {
  return typeof value === "string" && value.split("/").every((part) => part !== "" && part !== "." && part !== "..");
}

// Where a report is opened. The browser's ticket for it is a cookie, which the console gave it with the connection.
function address(report) {
  return `private/runs/${report.split("/").map(encodeURIComponent).join("/")}`;
}
