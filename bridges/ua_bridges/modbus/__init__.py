"""The bridge to devices that speak Modbus: PLCs and what hangs on them, by TCP, TLS or a serial line."""
