"""Programs that move the tip behind the guard: image, force curve, tactile path."""
