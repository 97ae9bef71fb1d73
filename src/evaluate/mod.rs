//! Flights, metrics and the consistency comparison.

pub mod flight;
