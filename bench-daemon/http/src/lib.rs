//! Rules of HTTP that every program with a page or an API shares: which hosts and pages may send
//! requests, how many of them, the shape of a refusal, and encryption. Knows no route and no bench.

mod origin;
mod rate;
mod refusal;
mod tls;

pub use origin::{Hosts, restrict};
pub use rate::Rate;
pub use refusal::{Code, Problem, Refusal, code_of};
pub use tls::acceptor;
