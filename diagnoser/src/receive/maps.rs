//! Maps for the streams: saved ones are served by one thread, made by another, so that nobody waits for maps
//! that are being made for somebody else.

use crate::diagnosis::Diagnoser;
use crate::live::Live;
use crate::map_library::{Choice, MapKey, MapLibrary};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};

/// Looks for saved maps; `None` where there are none that serve.
pub type FindMaps = Box<dyn Fn(&MapKey) -> Option<Result<Diagnoser, String>> + Send>;
/// Makes maps, which takes seconds.
pub type MakeMaps = Box<dyn Fn(&MapKey) -> Result<Diagnoser, String> + Send>;

/// Where maps come from.
pub struct MapSource {
    /// saved ones
    pub find: FindMaps,
    /// those that are not there are made, or (an error) what a person can do instead
    pub make: Result<MakeMaps, String>,
}

impl MapSource {
    /// Saved maps and no others.
    ///
    /// * `hint` what a person can do where none serve
    pub fn saved(library: MapLibrary, choice: Choice, hint: &str) -> Self {
        Self {
            find: Box::new(move |key| Some(library.diagnoser(key, &choice)?.map_err(|e| e.to_string()))),
            make: Err(hint.into()),
        }
    }
}

/// What has become of a wish.
enum News {
    /// saved maps, or why they cannot be had
    Found(Box<Result<Diagnoser, String>>),
    /// maps that were made, or why they could not be
    Made(Box<Result<Diagnoser, String>>),
    /// no saved ones; they may be made
    NoSaved,
}

/// The two threads that fetch maps.
pub(super) struct MapThreads {
    find: Sender<MapKey>,
    /// none where making is not wanted: then a search without success is an answer
    make: Option<Sender<MapKey>>,
    told: Receiver<(MapKey, News)>,
    /// saved maps that are being looked for
    pub looking: u64,
}

/// A thread that answers wishes one after the other.
fn answering(tell: Sender<(MapKey, News)>, answer: impl Fn(&MapKey) -> News + Send + 'static) -> Sender<MapKey> {
    let (ask, asked) = channel::<MapKey>();
    std::thread::spawn(move || {
        for key in asked {
            let news = answer(&key);
            if tell.send((key, news)).is_err() {
                return;
            }
        }
    });
    ask
}

impl MapThreads {
    pub fn start(source: MapSource) -> Self {
        let (tell, told) = channel();
        let MapSource { find, make } = source;
        let hint = make.as_ref().err().cloned();
        let find = answering(tell.clone(), move |key| match (find(key), &hint) {
            (Some(maps), _) => News::Found(Box::new(maps)),
            (None, Some(hint)) => News::Found(Box::new(Err(no_maps(key, hint)))),
            (None, None) => News::NoSaved,
        });
        let make = make
            .ok()
            .map(|make| answering(tell, move |key| News::Made(Box::new(make(key)))));
        Self {
            find,
            make,
            told,
            looking: 0,
        }
    }

    /// Hands the wishes of the streams over.
    pub fn ask(&mut self, live: &mut Live) {
        for key in live.wishes() {
            self.looking += 1;
            let _ = self.find.send(key);
        }
        for key in live.to_make() {
            if let Some(make) = &self.make {
                let _ = make.send(key);
            }
        }
    }

    /// Takes one piece of news, if there is any; returns whether there was.
    pub fn tell(&mut self, live: &mut Live) -> bool {
        let Ok((key, news)) = self.told.try_recv() else {
            return false;
        };
        match news {
            News::Found(maps) => {
                self.looking -= 1;
                live.maps(&key, maps.map(Arc::new));
            }
            News::NoSaved => {
                self.looking -= 1;
                live.no_saved_maps(&key);
            }
            News::Made(maps) => live.maps(&key, maps.map(Arc::new)),
        }
        true
    }
}

/// An error of a map source in the words of the diagnosis.
pub fn no_maps(key: &MapKey, hint: &str) -> String {
    format!("no maps for {} ({hint})", key.describe())
}
