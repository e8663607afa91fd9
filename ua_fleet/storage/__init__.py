"""What a process keeps on disk: reserved nonces, key files, the journal of executions."""
