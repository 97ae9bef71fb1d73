//! Exercises: entities, sight lines and epochs. A state machine without I/O.
