//! A network between an agent and its server that loses what a test says.

use std::{
    io::{Read, Write},
    net::{Shutdown, TcpListener, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicU8, AtomicUsize, Ordering},
    },
};

/// What is lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Loses {
    /// Nothing.
    Nothing = 0,
    /// Submissions to the queue.
    Submissions = 1,
    /// Answers to submissions to the queue.
    Answers = 2,
    /// Everything.
    Everything = 3,
}

/// The network.
#[derive(Clone)]
pub(crate) struct Between {
    pub(crate) address: String,
    loses: Arc<AtomicU8>,
    submissions: Arc<AtomicUsize>,
}

impl Between {
    /// Listens, and passes connections on to a server.
    pub(crate) fn to(server: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let between = Self {
            address: listener.local_addr().unwrap().to_string(),
            loses: Arc::default(),
            submissions: Arc::default(),
        };
        let (this, server) = (between.clone(), server.to_owned());
        std::thread::spawn(move || {
            for client in listener.incoming().flatten() {
                let (this, server) = (this.clone(), server.clone());
                std::thread::spawn(move || this.pass(&client, &server));
            }
        });
        between
    }

    pub(crate) fn lose(&self, loses: Loses) {
        self.loses.store(loses as u8, Ordering::SeqCst);
    }

    fn loses(&self, what: Loses) -> bool {
        self.loses.load(Ordering::SeqCst) == what as u8
    }

    /// Returns the number of submissions that were met since the start.
    pub(crate) fn submissions(&self) -> usize {
        self.submissions.load(Ordering::SeqCst)
    }

    fn pass(&self, client: &TcpStream, server: &str) {
        if self.loses(Loses::Everything) {
            return;
        }
        let Ok(server) = TcpStream::connect(server) else {
            return;
        };
        let (mut from, mut to) = (client.try_clone().unwrap(), server.try_clone().unwrap());
        let back = client.try_clone().unwrap();
        std::thread::spawn({
            let (this, server) = (self.clone(), server.try_clone().unwrap());
            move || this.pass_back(server, back)
        });
        let mut part = [0; 64 * 1024];
        while let Ok(count @ 1..) = from.read(&mut part) {
            let is_submission = part.starts_with(b"POST /api/v1/queue ");
            if is_submission {
                self.submissions.fetch_add(1, Ordering::SeqCst);
            }
            let is_lost = is_submission && self.loses(Loses::Submissions);
            if is_lost || self.loses(Loses::Everything) || to.write_all(&part[..count]).is_err() {
                break;
            }
        }
        let _ = server.shutdown(Shutdown::Both);
        let _ = client.shutdown(Shutdown::Both);
    }

    fn pass_back(&self, mut server: TcpStream, mut client: TcpStream) {
        let mut part = [0; 64 * 1024];
        while let Ok(count @ 1..) = server.read(&mut part) {
            let text = String::from_utf8_lossy(&part[..count]);
            let is_answer = text.starts_with("HTTP/1.1 201");
            let is_lost = is_answer && self.loses(Loses::Answers);
            if is_lost || client.write_all(&part[..count]).is_err() {
                break;
            }
        }
        let _ = client.shutdown(Shutdown::Both);
    }
}
