"""One-dimensional stable and unstable manifolds of saddle orbits, where they cross, and where they are tangent."""
