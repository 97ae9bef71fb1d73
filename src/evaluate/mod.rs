//! Flights, metrics, the consistency comparison and the trade report.

pub mod agreement;
pub mod consistency;
pub mod dice;
pub mod flight;
pub mod oracle;
pub mod record;
pub mod recording;
pub mod sabotage;
pub mod scenario;
pub mod trade;
