"""The light of objects scored at ground-truth probes: spheres, and the shadow of one."""
