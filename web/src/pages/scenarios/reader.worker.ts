/** Reads texts of scenarios in a thread of its own. */
import { answered, type Question } from './reading';

addEventListener('message', (event: MessageEvent<Question>) => postMessage(answered(event.data)));
