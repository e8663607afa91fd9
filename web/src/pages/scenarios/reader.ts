/** Asks the worker that reads a scenario's text. */
import { t } from '../../lib/texts';
import type { Answer, Question, Reading, ReadName } from './reading';

type Waiting = { done: (found: never) => void; failed: (error: Error) => void };

export class Reader {
  #worker = new Worker(new URL('./reader.worker.ts', import.meta.url), { type: 'module' });
  #waiting = new Map<number, Waiting>();
  #last = 0;
  #failed: Error | null = null;

  constructor() {
    this.#worker.onmessage = (event: MessageEvent<Answer>) => {
      const answer = event.data;
      const waiting = this.#waiting.get(answer.id);
      this.#waiting.delete(answer.id);
      if ('failed' in answer) waiting?.failed(new Error(answer.failed));
      else waiting?.done(answer.found as never);
    };
    // It could not be loaded, and answers nothing.
    this.#worker.onerror = () => {
      this.#failed = new Error(t('frame.not_loaded'));
      for (const one of this.#waiting.values()) one.failed(this.#failed);
      this.#waiting.clear();
    };
  }

  /** Answers come in the order of their questions. */
  ask<Name extends ReadName>(name: Name, ...given: Parameters<Reading[Name]>): Promise<ReturnType<Reading[Name]>> {
    const question: Question<Name> = { id: ++this.#last, name, given };
    return new Promise((done, failed) => {
      if (this.#failed) return failed(this.#failed);
      this.#waiting.set(question.id, { done, failed });
      this.#worker.postMessage(question);
    });
  }

  end(): void {
    this.#worker.terminate();
  }
}
