//! Dual-queue refinement of a view's mesh to a triangle budget, and the requirements of its sight lines.
