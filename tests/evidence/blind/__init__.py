"""The blind bench: runs of a leg with something hidden in them, made without the library that must find it."""
