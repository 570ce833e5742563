//! `fluvia view`: its server as programs speak to it, and its page in a browser.

mod browser;
mod client;
mod faults;
mod live;
mod many;
mod modules;
mod page;
mod pictures;
mod playback;
