//! Reads a stretch of a file in blocks on a thread of its own, so that one block is worked on while
//! the next is read.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::sync::mpsc::sync_channel;

/// Blocks that may be read ahead.
const AHEAD: usize = 3;

/// Hands the `length` bytes from `start` on to `take`, in order, in blocks of `block` bytes (the last
/// may be shorter). Stops at the first error, of the file or of `take`. The file's position moves.
pub(super) fn read_blocks<E: From<io::Error>>(
    mut file: &File,
    start: u64,
    length: u64,
    block: usize,
    mut take: impl FnMut(&[u8]) -> Result<(), E>,
) -> Result<(), E> {
    file.seek(SeekFrom::Start(start))?;
    let (blocks, read) = sync_channel::<io::Result<Vec<u8>>>(AHEAD);
    // Room for every buffer there is: giving one back never waits.
    let (give_back, used) = sync_channel::<Vec<u8>>(AHEAD + 2);
    std::thread::scope(|scope| {
        std::thread::Builder::new().name("reader".to_owned()).spawn_scoped(scope, move || {
            let mut left = length;
            while left > 0 {
                let size = usize::try_from(left).unwrap_or(usize::MAX).min(block);
                let mut bytes = used.try_recv().unwrap_or_default();
                bytes.resize(size, 0);
                let got = file.read_exact(&mut bytes).map(|()| bytes);
                let failed = got.is_err();
                // Nobody listens any more once `take` has failed.
                if blocks.send(got).is_err() || failed {
                    return;
                }
                left -= size as u64;
            }
        })?;
        // Moved in, so that the thread hears of it when this ends early.
        for bytes in read {
            let bytes = bytes?;
            take(&bytes)?;
            let _full = give_back.try_send(bytes);
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn blocks_come_in_order_until_an_error() {
        let mut file = tempfile::tempfile().unwrap();
        let all: Vec<u8> = (0..10_000u32).map(|i| (i % 251) as u8).collect();
        file.write_all(&all).unwrap();
        let mut got = Vec::new();
        read_blocks(&file, 3, 9_001, 128, |b| {
            got.extend_from_slice(b);
            io::Result::Ok(())
        })
        .unwrap();
        assert_eq!(got, all[3..9_004]);
        let too_far = read_blocks(&file, 9_000, 2_000, 128, |_| io::Result::Ok(()));
        assert_eq!(too_far.unwrap_err().kind(), io::ErrorKind::UnexpectedEof);
        let refused = read_blocks(&file, 0, 10_000, 16, |_| Err(io::Error::other("no")));
        assert_eq!(refused.unwrap_err().to_string(), "no");
    }
}
