/** Short notes that something was done, or was not. */
import type { ErrorBody } from '../lib/protocol';

export interface Toast {
  id: number;
  text: string;
  tone: 'ok' | 'note' | 'alarm';
}

class Toasts {
  shown = $state<Toast[]>([]);
  #next = 0;

  /** Something was done. It goes by itself. */
  say(text: string): void {
    this.#pass(text, 'ok');
  }

  /** Why something cannot be done. It goes by itself. */
  explain(text: string): void {
    this.#pass(text, 'note');
  }

  /** Something was not done. It stays until it is closed. */
  fail(error: ErrorBody | Error | string): void {
    this.#add(typeof error === 'string' ? error : error.message, 'alarm');
  }

  close(id: number): void {
    this.shown = this.shown.filter((one) => one.id !== id);
  }

  #pass(text: string, tone: Toast['tone']): void {
    const id = this.#add(text, tone);
    setTimeout(() => this.close(id), 6000);
  }

  #add(text: string, tone: Toast['tone']): number {
    const id = ++this.#next;
    this.shown = [...this.shown.filter((one) => one.text !== text), { id, text, tone }].slice(-4);
    return id;
  }
}

export const toasts = new Toasts();
