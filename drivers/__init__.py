"""Floor 1: bytes to physical units, one module a device. Knows buses and datasheets, nothing above."""
