"""Part 14 messages as bytes: pure, no I/O. What a message claims is checked; what it means is not."""
