"""The same devices emulated at the byte level: registers and frames, never the driver's own API."""
