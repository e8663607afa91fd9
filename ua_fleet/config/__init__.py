"""`fleet.yaml`: its schema, and loading it with the line of every problem."""
