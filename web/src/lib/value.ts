/** Values of OPC UA as people read them. */
import type { Json, Shown } from './protocol';
import { t } from './texts';

export type Quality = 'good' | 'uncertain' | 'bad';

/** The quality that a StatusCode tells by its two highest bits (OPC 10000-4 7.39). */
export function qualityOf(status: number): Quality {
  const severity = status >>> 30;
  return severity === 0 ? 'good' : severity === 1 ? 'uncertain' : 'bad';
}

const NAMES: Record<number, string> = {
  0x80020000: 'BadInternalError',
  0x800a0000: 'BadTimeout',
  0x80050000: 'BadCommunicationError',
  0x801f0000: 'BadUserAccessDenied',
  0x80310000: 'BadNoCommunication',
  0x80320000: 'BadWaitingForInitialData',
  0x80340000: 'BadNodeIdUnknown',
  0x808b0000: 'BadDeviceFailure',
  0x808c0000: 'BadSensorFailure',
  0x808d0000: 'BadOutOfService',
  0x808a0000: 'BadNotConnected',
  0x803c0000: 'BadOutOfRange',
  0x80890000: 'BadConfigurationError',
  0x408f0000: 'UncertainNoCommunicationLastUsableValue',
  0x40900000: 'UncertainLastUsableValue',
  0x40920000: 'UncertainInitialValue',
  0x40930000: 'UncertainSensorNotAccurate',
  0x40940000: 'UncertainEngineeringUnitsExceeded',
};

/** A StatusCode by its name, or in hexadecimal where this page knows none. */
export function statusName(status: number): string {
  if (status === 0) return 'Good';
  const code = (status & 0xffff0000) >>> 0;
  return NAMES[code] ?? `0x${(status >>> 0).toString(16).toUpperCase().padStart(8, '0')}`;
}

/** A quality in a word; of what is not of now, what it was. */
export function qualityText(quality: Quality, current: boolean): string {
  const text = t(`quality.${quality}`);
  return current ? text : t('quality.was', { quality: text });
}

/** Whether a value has never come. */
export function isNever(shown: Shown): boolean {
  return (shown.s & 0xffff0000) >>> 0 === 0x80320000;
}

/** What a 32-bit number holds. */
const DIGITS = 7;

/** A number in as many digits as mean something, or fewer of them; no exponent where plain digits are short. */
export function formatNumber(value: number, digits = DIGITS): string {
  if (!Number.isFinite(value)) return Number.isNaN(value) ? 'NaN' : value > 0 ? '∞' : '−∞';
  if (Number.isInteger(value) && Math.abs(value) < 1e15) return String(value).replace('-', '−');
  const size = Math.abs(value);
  const text =
    size !== 0 && (size < 1e-4 || size >= 1e15) ? value.toExponential(3) : String(Number(value.toPrecision(digits)));
  return text.replaceAll('-', '−');
}

function isObject(value: Json): value is { [key: string]: Json } {
  return typeof value === 'object' && value !== null && !Array.isArray(value);
}

/** The number that a value stands for, where it stands for one. */
export function numberOf(value: Json): number | null {
  if (typeof value === 'number') return value;
  if (typeof value === 'boolean') return value ? 1 : 0;
  if (isObject(value)) {
    if (typeof value.int === 'string') return Number(value.int);
    if (typeof value.float === 'string') return value.float === 'NaN' ? NaN : Number(value.float);
  }
  return null;
}

/** Signs that would change how the text around them is read: of control, and of direction. */
const SIGNS = /[\u0000-\u001f\u007f-\u009f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]/g;

function escaped(text: string): string {
  return text.replace(SIGNS, (sign) => `\\u${sign.charCodeAt(0).toString(16).padStart(4, '0')}`);
}

/** A value in one line of text; long ones are cut by what shows them. */
export function formatValue(value: Json, digits = DIGITS): string {
  if (value === null) return '—';
  if (typeof value === 'number') return formatNumber(value, digits);
  if (typeof value === 'boolean') return value ? 'true' : 'false';
  if (typeof value === 'string') return escaped(value);
  if (Array.isArray(value)) return `[${value.map((one) => formatValue(one, digits)).join(', ')}]`;
  const keys = Object.keys(value);
  if (keys.length === 1 && typeof value.int === 'string') return value.int.replace('-', '−');
  if (keys.length === 1 && typeof value.float === 'string') return formatNumber(numberOf(value) ?? NaN, digits);
  if (typeof value.bytes === 'number' && keys.every((key) => key === 'bytes' || key === 'base64')) {
    return `${value.bytes} bytes`;
  }
  // The console tells of what is long its beginning, and how long it is; that goes first, since what follows is cut.
  if (keys.length === 2 && typeof value.text === 'number' && typeof value.first === 'string') {
    return t('value.long_text', { n: value.text, first: escaped(value.first) });
  }
  if (keys.length === 2 && typeof value.array === 'number' && Array.isArray(value.first)) {
    return t('value.long_array', { n: value.array, first: formatValue(value.first, digits) });
  }
  return `{${keys.map((key) => `${key}: ${formatValue(value[key] ?? null, digits)}`).join(', ')}}`;
}
