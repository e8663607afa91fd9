/** Times and ages as people read them. */

export const NOW_S = 3;

/**
 * Of a robot in a list. Its time comes by a summary: each of them moves once a second at most, so one that tells
 * something each second is 1 to 4 s old there, and would be `now` and `3 s ago` in turn. One that lives tells something
 * each 5 s; whether it is silent says its quality.
 */
export const LISTED_NOW_S = 5;

/** How long ago in the fewest signs that mean something: `now`, `8 s`, `3 min`, `2 h`, `5 d`. */
export function formatAge(seconds: number, now_s = NOW_S): string {
  // Clocks of robots differ a little: a value of the near future is one of now. So is what comes once a second: its age
  // would be another one at each look, and a source is silent after 3 s.
  if (seconds < now_s) return seconds < -2 ? `in ${formatDuration(-seconds)}` : 'now';
  return formatDuration(seconds);
}

/** A duration in one unit, rounded down. */
export function formatDuration(seconds: number): string {
  if (seconds < 1) return `${Math.max(0, Math.round(seconds * 1000))} ms`;
  if (seconds < 60) return `${Math.floor(seconds)} s`;
  if (seconds < 3600) return `${Math.floor(seconds / 60)} min`;
  if (seconds < 86400) return `${Math.floor(seconds / 3600)} h`;
  return `${Math.floor(seconds / 86400)} d`;
}

const SIZES = [86400, 3600, 60, 1];

/** A duration in its two greatest units, rounded down: `3 min 20 s`. */
export function formatLength(seconds: number): string {
  const at = SIZES.findIndex((size) => seconds >= size);
  const [size, below] = [SIZES[at] ?? 1, SIZES[at + 1] ?? 1];
  const rest = Math.floor((seconds % size) / below) * below;
  return rest > 0 ? `${formatDuration(seconds)} ${formatDuration(rest)}` : formatDuration(seconds);
}

/** Seconds between a time in ISO 8601 and `nowMs` (of Date.now); null of what is no time. */
export function ageOf(time: string | null | undefined, nowMs: number): number | null {
  if (!time) return null;
  const at = Date.parse(time);
  return Number.isNaN(at) ? null : (nowMs - at) / 1000;
}

let day = { from: 0, to: 0 };

/** Whether two times are of one day here; asked for of many times and the same `nowMs`. */
function isSameDay(at: number, nowMs: number): boolean {
  if (nowMs < day.from || nowMs >= day.to) {
    const [year, month, date] = [new Date(nowMs).getFullYear(), new Date(nowMs).getMonth(), new Date(nowMs).getDate()];
    day = { from: new Date(year, month, date).getTime(), to: new Date(year, month, date + 1).getTime() };
  }
  return at >= day.from && at < day.to;
}

const pad = (value: number, width = 2) => String(value).padStart(width, '0');

/** The time of day here, with the date where it is not today's; milliseconds only when asked for. */
export function formatTime(time: string | null | undefined, nowMs: number, milliseconds = false): string {
  if (!time) return '—';
  const at = new Date(time);
  if (Number.isNaN(at.getTime())) return '—';
  const clock = `${pad(at.getHours())}:${pad(at.getMinutes())}:${pad(at.getSeconds())}`;
  const exact = milliseconds ? `${clock}.${pad(at.getMilliseconds(), 3)}` : clock;
  if (isSameDay(at.getTime(), nowMs)) return exact;
  return `${at.getFullYear()}-${pad(at.getMonth() + 1)}-${pad(at.getDate())} ${exact}`;
}
