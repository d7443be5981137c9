//! Writes blocks of bytes on a thread of its own, so that the next block is made meanwhile.

use std::fs::File;
use std::io::{self, Write};
use std::mem;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

/// Blocks that may wait for the disk: enough to keep it busy, few in memory.
const WAITING: usize = 3;

/// Which of a writer's files a block goes to, and the block.
type Block = (usize, Vec<u8>);

/// Appends blocks to one or more files, in the order in which they are sent.
///
/// An error of the disk comes back from the next [`BlockWriter::send`] or from
/// [`BlockWriter::finish`]. Dropped, it ends after the blocks that wait.
#[derive(Debug)]
pub(super) struct BlockWriter {
    blocks: Option<SyncSender<Block>>,
    /// Buffers that were written and can be filled again.
    written: Receiver<Vec<u8>>,
    thread: Option<JoinHandle<io::Result<Vec<File>>>>,
}

impl BlockWriter {
    /// Starts a writer for `files`, each at its present position.
    pub(super) fn start(mut files: Vec<File>) -> io::Result<Self> {
        let (blocks, waiting) = sync_channel::<Block>(WAITING);
        // Room for every buffer there is: giving one back never waits.
        let (give_back, written) = sync_channel(WAITING + 2);
        let write = move || {
            for (file, bytes) in waiting {
                if let Some(file) = files.get_mut(file) {
                    file.write_all(&bytes)?;
                }
                // Nobody wants it back once the writer is being dropped.
                let _unwanted = give_back.try_send(bytes);
            }
            Ok(files)
        };
        let thread = std::thread::Builder::new().name("writer".to_owned()).spawn(write)?;
        Ok(Self { blocks: Some(blocks), written, thread: Some(thread) })
    }

    /// A buffer to fill: one written before, as it was, if there is one; else an empty one.
    pub(super) fn buffer(&self) -> Vec<u8> {
        self.written.try_recv().unwrap_or_default()
    }

    /// Hands on a block for file number `file`; waits while the disk is far behind.
    pub(super) fn send(&mut self, file: usize, bytes: Vec<u8>) -> io::Result<()> {
        match &self.blocks {
            Some(blocks) if blocks.send((file, bytes)).is_ok() => Ok(()),
            _ => self.stop().map(drop),
        }
    }

    /// Waits until everything is handed to the system and returns the files.
    pub(super) fn finish(mut self) -> io::Result<Vec<File>> {
        self.stop()
    }

    fn stop(&mut self) -> io::Result<Vec<File>> {
        self.blocks = None;
        let ended = || io::Error::other("the writing thread ended early");
        mem::take(&mut self.thread).ok_or_else(ended)?.join().map_err(|_| ended())?
    }
}

impl Drop for BlockWriter {
    fn drop(&mut self) {
        if self.thread.is_some() {
            let _too_late = self.stop();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Seek};

    use super::*;

    #[test]
    fn blocks_arrive_in_order_and_errors_come_back() {
        let file = tempfile::tempfile().unwrap();
        let mut writer = BlockWriter::start(vec![file.try_clone().unwrap()]).unwrap();
        for i in 0..100u8 {
            let mut bytes = writer.buffer();
            bytes.clear();
            bytes.resize(1000, i);
            writer.send(0, bytes).unwrap();
        }
        let mut file = writer.finish().unwrap().remove(0);
        let mut all = Vec::new();
        file.rewind().unwrap();
        file.read_to_end(&mut all).unwrap();
        assert!(all.chunks(1000).enumerate().all(|(i, c)| c.iter().all(|&b| usize::from(b) == i)));

        // A file that cannot be written to.
        let place = tempfile::NamedTempFile::new().unwrap();
        let mut writer = BlockWriter::start(vec![File::open(place.path()).unwrap()]).unwrap();
        let failed = (0..100).find_map(|_| writer.send(0, vec![1]).err());
        assert!(failed.is_some());
        // And again, not a panic.
        assert!(writer.send(0, vec![1]).is_err() && writer.finish().is_err());
    }
}
