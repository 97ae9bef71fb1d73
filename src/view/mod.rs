//! Cameras: pose, projection, frustum, and the bound on screen-space distortion that orders refinement.
