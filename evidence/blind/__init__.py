"""Families of legs with something hidden in them, made without the library that must find it, and what it finds."""
