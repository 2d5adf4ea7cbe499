//! Asynchronous code in a thread with a runtime, until it is dropped.

use std::sync::mpsc;
use std::thread::JoinHandle;

use tokio::sync::oneshot;

/// Signals a future in the background to end.
pub type Stopped = oneshot::Receiver<()>;

/// A thread that runs a future.
#[derive(Debug)]
pub struct Background {
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Background {
    /// Calls `listen` in a new thread; returns its value, such as an address. The thread then runs its future, which ends after
    /// `Stopped`.
    ///
    /// # Panics
    ///
    /// When the machine has no thread or runtime for it, or `listen` panics.
    #[must_use]
    pub fn start<T, L, F>(listen: L) -> (Self, T)
    where
        T: Send + 'static,
        L: AsyncFnOnce(Stopped) -> (T, F) + Send + 'static,
        F: Future<Output = ()>,
    {
        let (stop, stopped) = oneshot::channel();
        let (tell, told) = mpsc::channel();
        let thread = std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
            runtime.block_on(async {
                let (value, run) = listen(stopped).await;
                tell.send(value).expect("the test waits");
                run.await;
            });
        });
        let value = told.recv().expect("the thread starts");
        (Self { stop: Some(stop), thread: Some(thread) }, value)
    }

    /// Ends the thread.
    ///
    /// # Panics
    ///
    /// When it has panicked.
    pub fn end(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
            && !std::thread::panicking()
        {
            panic!("a thread in the background has panicked");
        }
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        self.end();
    }
}

/// Runs a future until it ends or the thread must end.
pub(crate) async fn until(stopped: Stopped, run: impl Future<Output = ()>) {
    tokio::select! {
        () = run => {}
        _ = stopped => {}
    }
}
