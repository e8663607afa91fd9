"""A virtual fleet on a virtual clock, beside what the published equations expect of it."""
