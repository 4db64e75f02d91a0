"""Virtual objects in the picture: objects and materials, light, rendering, shadows on real surfaces, compositing."""
