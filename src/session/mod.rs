//! A view's life: pose in, frame out. Without I/O.
