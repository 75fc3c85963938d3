//! Raw TCP sockets, as instruments serve them on ports such as 5025: no telnet, no framing.

use std::io;

use tokio::net::TcpStream;

pub(super) async fn open(host: &str, port: u16) -> io::Result<TcpStream> {
    let host = host.trim_start_matches('[').trim_end_matches(']');
    let stream = TcpStream::connect((host, port)).await?;
    // Every message is one small packet whose receiver is waiting.
    stream.set_nodelay(true)?;
    Ok(stream)
}
