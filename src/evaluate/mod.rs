//! Flights, metrics and the consistency comparison.
