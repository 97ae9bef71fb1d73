//! Flights, metrics and the consistency comparison.

pub mod agreement;
pub mod consistency;
pub mod dice;
pub mod flight;
pub mod oracle;
pub mod record;
pub mod recording;
pub mod sabotage;
pub mod scenario;
