/** Questions to a thread of its own. Each has a number, by which its answer is known. */
import { t } from './texts';

export type Answer<Found> = { id: number } & ({ found: Found } | { failed: string });

type Waiting<Found> = { done: (found: Found) => void; failed: (error: Error) => void };

export class WorkerClient<Question extends object, Found> {
  #worker: Worker;
  #waiting = new Map<number, Waiting<Found>>();
  #last = 0;
  #failed: Error | null = null;

  constructor(worker: Worker) {
    this.#worker = worker;
    worker.onmessage = (event: MessageEvent<Answer<Found>>) => {
      const answer = event.data;
      const waiting = this.#waiting.get(answer.id);
      this.#waiting.delete(answer.id);
      if ('failed' in answer) waiting?.failed(new Error(answer.failed));
      else waiting?.done(answer.found);
    };
    // It could not be loaded, and answers nothing.
    worker.onerror = () => {
      this.#failed = new Error(t('frame.not_loaded'));
      for (const one of this.#waiting.values()) one.failed(this.#failed);
      this.#waiting.clear();
    };
  }

  /** Ask, and hand `moved` over, which is gone here then. */
  ask(question: Question, moved: Transferable[] = []): Promise<Found> {
    const id = ++this.#last;
    return new Promise((done, failed) => {
      if (this.#failed) return failed(this.#failed);
      this.#waiting.set(id, { done, failed });
      this.#worker.postMessage({ ...question, id }, moved);
    });
  }

  end(): void {
    this.#worker.terminate();
  }
}
