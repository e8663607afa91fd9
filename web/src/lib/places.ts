/** Addresses within the page: `#/FLEET/PAGE/REST…?name=value`. */
export interface Place {
  fleet: string;
  page: string;
  rest: readonly string[];
  query: Readonly<Record<string, string>>;
}

function decoded(text: string): string {
  try {
    return decodeURIComponent(text);
  } catch {
    return text; // typed by hand
  }
}

export function parsePlace(hash: string): Place {
  const [path = '', search = ''] = hash.replace(/^#\/?/, '').split('?', 2);
  const [fleet = '', page = '', ...rest] = path.split('/').filter(Boolean).map(decoded);
  return { fleet, page, rest, query: Object.fromEntries(new URLSearchParams(search)) };
}

export function formatPlace(place: Place): string {
  const path = [place.fleet, place.page, ...place.rest].filter(Boolean).map(encodeURIComponent).join('/');
  const search = new URLSearchParams(place.query).toString();
  return `#/${path}${search ? `?${search}` : ''}`;
}
