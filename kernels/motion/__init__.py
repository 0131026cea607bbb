"""How a camera moves: tiles of a frame against planes of other frames, and where planes were before."""
