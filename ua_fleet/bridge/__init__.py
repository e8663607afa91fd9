"""The kit that every UA bridge stands on."""
