/** Times and ages as people read them. */

export const NOW_S = 3;

/** How long ago in the fewest signs that mean something: `now`, `8 s`, `3 min`, `2 h`, `5 d`. */
export function formatAge(seconds: number): string {
  // Clocks of robots differ a little: a value of the near future is one of now. So is what comes once a second: its age
  // would be another one at each look, and a source is silent after 3 s.
  if (seconds < NOW_S) return seconds < -2 ? `in ${formatDuration(-seconds)}` : 'now';
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

/** Seconds between a time in ISO 8601 and `nowMs` (of Date.now); null of what is no time. */
export function ageOf(time: string | null | undefined, nowMs: number): number | null {
  if (!time) return null;
  const at = Date.parse(time);
  return Number.isNaN(at) ? null : (nowMs - at) / 1000;
}

const pad = (value: number, width = 2) => String(value).padStart(width, '0');

/** The time of day here, with the date where it is not today's; milliseconds only when asked for. */
export function formatTime(time: string | null | undefined, nowMs: number, milliseconds = false): string {
  if (!time) return '—';
  const at = new Date(time);
  if (Number.isNaN(at.getTime())) return '—';
  const now = new Date(nowMs);
  const clock = `${pad(at.getHours())}:${pad(at.getMinutes())}:${pad(at.getSeconds())}`;
  const exact = milliseconds ? `${clock}.${pad(at.getMilliseconds(), 3)}` : clock;
  if (at.toDateString() === now.toDateString()) return exact;
  return `${at.getFullYear()}-${pad(at.getMonth() + 1)}-${pad(at.getDate())} ${exact}`;
}
