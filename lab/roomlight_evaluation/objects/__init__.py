"""The light of objects scored at ground-truth probes: spheres, the shadow of one, and unseen directions in a mirror."""
