import { expect, it } from 'vitest';
import { t } from './texts';

it('fills names in, and leaves braces that are none of them', () => {
  expect(t('common.ago', { age: '8 s' })).toBe('8 s ago');
  expect(t('common.ago')).toBe('{age} ago');
  // A value is not looked at again.
  expect(t('frame.failed', { error: '{error}' })).toBe('This page has failed: {error}');
});
