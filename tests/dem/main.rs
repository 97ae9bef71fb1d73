//! The elevation readers, from outside: each format on small samples written here, hostile ones among them, and real
//! files where the folder with them is named.

mod real;
