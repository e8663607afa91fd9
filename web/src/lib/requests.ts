/** Requests to the console: JSON there and back, and each error in one line. */
import { Unanswered, isCommand, isDoneOnce, placeToLook } from './commands';
import type { ErrorBody, Fleets, Json, Me } from './protocol';
import { t } from './texts';

const TIMEOUT_MS = 30_000;

/** What the console, or the server behind it, did not do, and why. */
export class RequestError extends Error {
  override name = 'RequestError';

  constructor(
    /** The status of HTTP; 0 where no answer came. */
    readonly http: number,
    readonly body: ErrorBody,
    /** Seconds after which it may be tried again, where the console said so. */
    readonly retryAfterS: number | null = null,
    /** Whether it may have been done: it was sent, and the console's answer did not come. */
    readonly unanswered = false,
  ) {
    super(body.message);
  }
}

let csrf = '';
let whenLoggedOut: () => void = () => {};

/** What is to be done when the console does not know this browser any more. */
export function onLoggedOut(act: () => void): void {
  whenLoggedOut = act;
}

let userAt: (fleet: string) => string = () => '';

/** As whom this page commands at a fleet: the console refuses what comes from a page that shows another person. */
export function setUserAt(user: (fleet: string) => string): void {
  userAt = user;
}

/** The person that this page shows at a fleet; empty: nobody. */
export const shownUser = (fleet: string): string => userAt(fleet);

const unanswered = new Unanswered();
let whenRepeated: () => void = () => {};

/** What is to be done when the console had done a command already, which was sent again since no answer had come. */
export function onRepeated(act: () => void): void {
  whenRepeated = act;
}

/** The token that belongs to the login; each request has it. */
export function setCsrf(token: string): void {
  csrf = token;
}

export const csrfToken = () => csrf;

const json = (answer: Response): Promise<unknown> => answer.json();

async function ask<T>(path: string, init: RequestInit, read = json): Promise<T> {
  let answer: Response;
  try {
    answer = await fetch(path, { ...init, credentials: 'same-origin', signal: AbortSignal.timeout(TIMEOUT_MS) });
  } catch (error) {
    const late = error instanceof DOMException && error.name === 'TimeoutError';
    const message = late ? t('errors.late', { n: TIMEOUT_MS / 1000 }) : t('errors.no_console');
    throw new RequestError(0, { message }, null, true);
  }
  let body: unknown = null;
  try {
    body = await (answer.ok ? read : json)(answer);
  } catch {
    const message = t('errors.no_json', { code: answer.status });
    if (answer.ok) throw new RequestError(answer.status, { message }, null, true);
  }
  if (answer.ok) {
    if (answer.headers.has('Idempotent-Replayed')) whenRepeated();
    return body as T;
  }
  const told = (body as { error?: ErrorBody } | null)?.error;
  const after = Number(answer.headers.get('Retry-After'));
  const error = new RequestError(
    answer.status,
    told ?? { message: t('errors.unnamed', { code: answer.status }) },
    Number.isFinite(after) && after > 0 ? after : null,
    !told && answer.status >= 500, // of a proxy, which does not know
  );
  if (answer.status === 401 && !path.endsWith('/login') && !path.endsWith('/me')) whenLoggedOut();
  throw error;
}

function post<T>(path: string, body: unknown, read = json, more: Record<string, string> = {}): Promise<T> {
  const headers: Record<string, string> = { 'Content-Type': 'application/json', ...more };
  if (csrf) headers['X-CSRF'] = csrf;
  return ask<T>(path, { method: 'POST', headers, body: JSON.stringify(body) }, read);
}

/** Do an operation at a fleet, as `operation('hall', 'robots.hold', {robot: 'arm', reason: '…'})`. */
export async function operation<T = Json>(fleet: string, name: string, parameters: object = {}): Promise<T> {
  const path = `api/${encodeURIComponent(fleet)}/${name}`;
  const user = userAt(fleet);
  const more: Record<string, string> = user ? { 'X-User': encodeURIComponent(user) } : {};
  if (!isCommand(name)) return (await post<{ result: T }>(path, parameters, json, more)).result;
  const command = JSON.stringify([fleet, name, parameters]);
  const key = unanswered.key(command, Date.now());
  try {
    return (await post<{ result: T }>(path, parameters, json, { ...more, 'Idempotency-Key': key.key })).result;
  } catch (error) {
    if (!(error instanceof RequestError && error.unanswered)) throw error;
    if (isDoneOnce(name)) unanswered.lost(command, key);
    throw new RequestError(error.http, { message: t(placeToLook(name)) }, null, true);
  }
}

/** What some operations answer: bytes, and before them what is said of them. */
export interface Framed<Head> {
  head: Head;
  bytes: Uint8Array<ArrayBuffer>;
}

async function framed(answer: Response): Promise<unknown> {
  const body = await answer.arrayBuffer();
  const length = new DataView(body).getUint32(0);
  const head: unknown = JSON.parse(new TextDecoder().decode(new Uint8Array(body, 4, length)));
  return { head, bytes: new Uint8Array(body, 4 + length) };
}

/** Do an operation whose answer is bytes. */
export const operationBytes = <Head>(fleet: string, name: string, parameters: object) =>
  post<Framed<Head>>(`api/${encodeURIComponent(fleet)}/${name}`, parameters, framed);

export const getFleets = () => ask<Fleets>('api/fleets', {});

/** Who is logged in; null: nobody. */
export async function getMe(): Promise<Me | null> {
  try {
    return await ask<Me>('api/me', {});
  } catch (error) {
    if (error instanceof RequestError && error.http === 401) return null;
    throw error;
  }
}

export const postLogin = (fleet: string, user: string, password: string) =>
  post<Me>('api/login', { fleet, user, password });

export const postLogout = (fleet?: string) => post<unknown>('api/logout', fleet ? { fleet } : {});
