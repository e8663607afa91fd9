/** Asks the worker that reads a scenario's text. Answers come in the order of their questions. */
import { WorkerClient } from '../../lib/worker';
import type { Question, Reading, ReadName } from './reading';

export class Reader {
  #worker = new WorkerClient<Omit<Question, 'id'>, unknown>(
    new Worker(new URL('./reader.worker.ts', import.meta.url), { type: 'module' }),
  );

  ask<Name extends ReadName>(name: Name, ...given: Parameters<Reading[Name]>): Promise<ReturnType<Reading[Name]>> {
    return this.#worker.ask({ name, given }) as Promise<ReturnType<Reading[Name]>>;
  }

  end(): void {
    this.#worker.end();
  }
}
