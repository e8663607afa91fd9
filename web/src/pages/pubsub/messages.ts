/** Messages of the feed `messages`, and their bytes with the names that they have. */

/** An entry of the feed. */
export interface Heard {
  number: number;
  time: string | null;
  sent: boolean;
  address: string;
  /** Bytes of the whole message. */
  size: number;
  /** Its beginning, base64. */
  data: string;
  /** Whether it was let in; else it is as it came. */
  open: boolean;
  security: 'None' | 'Sign' | 'SignAndEncrypt';
  token: number;
  chunks: boolean;
  /** Causes for which it, or a part of it, was dropped. */
  dropped: string[];
  publisher: string | null;
  group: number | null;
  writers: number[];
  kind: string;
}

/** Some bytes of a message, and what they are (ua_fleet.dissect.spans). */
export interface Span {
  at: number;
  size: number;
  section: string;
  name: string;
  text: string;
}

export interface Dissected {
  spans: Span[];
  error: string;
}

/** Which messages: what is new, those that were dropped, or all. */
export type Wish = '' | 'dropped' | 'all';

/** Dropped so, a message was there already. */
const KNOWN = ['repeated', 'loop', 'duplicate'];

/** Whether it does more than attest a source, or say again what was said. */
function isNews(one: Heard): boolean {
  return one.kind !== 'keep-alive' && !(one.dropped.length && one.dropped.every((cause) => KNOWN.includes(cause)));
}

/** The newest first. */
export function selectedMessages(entries: ReadonlyMap<string, Heard | number>, wish: Wish): Heard[] {
  const rows: Heard[] = [];
  for (const one of entries.values()) {
    if (typeof one === 'number') continue;
    if (wish === 'dropped' && one.dropped.length === 0) continue;
    if (wish === '' && !isNews(one)) continue;
    rows.push(one);
  }
  return rows.sort((a, b) => b.number - a.number);
}

/** The NodeId of what a data message is about: one DataSet of a namespace that the server has. */
export function nodeOf(one: Heard): string | null {
  return one.group && one.writers.length === 1 ? `ns=${one.group};i=${one.writers[0]}` : null;
}

/** Whose a message is: its UA topic, or its publisher. */
export function sourceOf(one: Heard): string {
  if (one.publisher === null) return '';
  const [writer, ...more] = one.writers;
  if (one.group === null || writer === undefined || !/^\d+$/.test(one.publisher)) return one.publisher;
  return `ua_${one.publisher}_${one.group}_${writer}${more.length ? ` +${more.length}` : ''}`;
}

export function bytesOf(base64: string): Uint8Array {
  return Uint8Array.from(atob(base64), (sign) => sign.charCodeAt(0));
}

export const hex = (byte: number) => byte.toString(16).padStart(2, '0');

/** A byte as ASCII; a dot for what has no sign there. */
export const ascii = (byte: number) => (byte > 0x20 && byte < 0x7f ? String.fromCharCode(byte) : '·');

/** For each byte the index of its span; -1: none has been told. */
export function spanOfBytes(size: number, spans: readonly Span[]): Int32Array {
  const found = new Int32Array(size).fill(-1);
  spans.forEach((span, index) => found.fill(index, span.at, Math.min(size, span.at + span.size)));
  return found;
}

export interface Section {
  name: string;
  spans: { index: number; span: Span }[];
}

/** Spans by the part of the message that they belong to, in order. */
export function sectionsOf(spans: readonly Span[]): Section[] {
  const sections: Section[] = [];
  spans.forEach((span, index) => {
    let last = sections.at(-1);
    if (last?.name !== span.section) sections.push((last = { name: span.section, spans: [] }));
    last.spans.push({ index, span });
  });
  return sections;
}

/** Bytes as pairs of digits, cut after the first ones. */
export function hexOf(bytes: Uint8Array, most = 8): string {
  const shown = Array.from(bytes.subarray(0, most), hex).join(' ');
  return bytes.length > most ? `${shown} …` : shown;
}
