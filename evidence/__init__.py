"""Programs that measure, and the plants that they measure on. They are not part of the wheel."""
