/** A step that is no task, in words. */
import { t } from '../../lib/texts';
import type { Step } from './types';

export function titleOf(step: Step): string {
  switch (step.kind) {
    case 'task':
      return step.name;
    case 'sequence':
    case 'parallel':
      return t(`scenarios.step_${step.kind}`);
    case 'if':
      return t('scenarios.step_if', { when: step.when });
    case 'repeat': {
      const times = step.times === null ? '' : t('scenarios.step_times', { n: step.times });
      const holds = step.while === null ? '' : t('scenarios.step_while', { when: step.while });
      return t('scenarios.step_repeat', { how: [times, holds].filter(Boolean).join(', ') });
    }
    case 'wait':
      if (step.event) return t('scenarios.step_wait_event', { event: step.event });
      if (step.until) return t('scenarios.step_wait_until', { when: step.until });
      return t('scenarios.step_wait', { s: step.for_s ?? 0 });
    case 'end':
      return [t(`scenarios.step_end_${step.outcome === 'failed' ? 'failed' : 'done'}`), step.reason]
        .filter(Boolean)
        .join(': ');
  }
}
