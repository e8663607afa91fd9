/** Light, dark, or as the system has it; kept in this browser. */
export type Theme = 'system' | 'light' | 'dark';

const KEY = 'ua-fleet.theme';

function kept(): Theme {
  try {
    const value = localStorage.getItem(KEY);
    return value === 'light' || value === 'dark' ? value : 'system';
  } catch {
    return 'system'; // a browser that keeps nothing
  }
}

class ThemeChoice {
  chosen = $state<Theme>(kept());
  #system = $state<'light' | 'dark'>('light');

  constructor() {
    const query = matchMedia('(prefers-color-scheme: dark)');
    const hear = () => {
      this.#system = query.matches ? 'dark' : 'light';
      this.#apply();
    };
    query.addEventListener('change', hear);
    hear();
  }

  /** What is shown now. */
  get shown(): 'light' | 'dark' {
    return this.chosen === 'system' ? this.#system : this.chosen;
  }

  choose(theme: Theme): void {
    this.chosen = theme;
    try {
      if (theme === 'system') localStorage.removeItem(KEY);
      else localStorage.setItem(KEY, theme);
    } catch {
      // it lasts as long as this page does
    }
    this.#apply();
  }

  #apply(): void {
    document.documentElement.dataset.theme = this.shown;
  }
}

export const theme = new ThemeChoice();
