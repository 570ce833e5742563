//! The thread that decides what everybody sees: it keeps time, obeys, and publishes.
//!
//! Commands are carried out in the order in which they came. Every step is published, so that a row of them is seen as such.

use std::collections::VecDeque;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use fluvia_view::{Command, Frame, Message, Mode, Server, State};

use crate::report::one_line;

/// What can be shown: a simulation, or frames on disk.
pub trait Show {
    /// The walls, which do not change.
    fn walls(&self) -> fluvia_view::walls::Walls;

    /// Seconds between frames.
    fn dt(&self) -> f64;

    /// Whether frames can be left out.
    fn can_skip(&self) -> bool;

    /// Goes so many frames on, or back; where none can be left out it is asked for one.
    fn advance(&mut self, frames: i64) -> Result<()>;

    /// Whether there is nothing to advance to.
    fn is_over(&self) -> bool;

    /// Carries out a command that is not about time.
    ///
    /// # Errors
    /// Why it was not carried out: nothing has changed then.
    fn obey(&mut self, command: &Command) -> Result<()>;

    /// What somebody should know of what has happened since it was asked last.
    fn news(&mut self) -> Option<String>;

    /// The frame now; with densities if they are wanted.
    fn frame(&mut self, with_density: bool) -> Frame<'_>;

    /// All that is known but how time passes and what was said.
    fn describe(&self) -> State;
}

/// How fast time can be chosen to pass.
const SPEEDS: std::ops::RangeInclusive<f64> = 0.01..=100.0;

/// Without a next frame: how long to wait for commands at a time.
const IDLE: Duration = Duration::from_secs(3600);

/// Frames that are left out at a time at most: more is no lag but a machine that slept.
const MOST_BEHIND: f64 = 100.0;

/// Commands that are taken from the server at most before those that were taken are carried out.
const MOST_WAITING: usize = 64;

/// The thread's state.
pub struct Stage<S> {
    server: Server,
    commands: Receiver<Command>,
    /// What has come and was not carried out yet.
    waiting: VecDeque<Command>,
    show: S,
    playing: bool,
    /// Whether anybody has come to look: time does not pass before.
    is_seen: bool,
    /// Simulated seconds in a second; none: as fast as possible.
    speed: Option<f64>,
    /// When the next frame is due.
    due: Instant,
    message: Option<Message>,
}

impl<S: Show> Stage<S> {
    pub fn new(server: Server, commands: Receiver<Command>, show: S, playing: bool) -> Stage<S> {
        Stage {
            server,
            commands,
            waiting: VecDeque::new(),
            show,
            playing,
            is_seen: false,
            speed: Some(1.0),
            due: Instant::now(),
            message: None,
        }
    }

    /// Runs for as long as the process does.
    pub fn run(&mut self) {
        self.server.publish_walls(&self.show.walls());
        self.publish();
        loop {
            // Else nothing came in time: the other end is with the server, which is ours.
            if let Ok(first) = self.commands.recv_timeout(self.wait()) {
                self.waiting.push_back(first);
                self.take();
                self.obey_all();
            }
            if self.passes() && self.due <= Instant::now() {
                self.go_on();
            }
        }
    }

    /// Whether time passes.
    fn passes(&self) -> bool {
        self.playing && self.is_seen
    }

    /// How long there is nothing to do but to obey.
    fn wait(&self) -> Duration {
        if self.passes() { self.due.saturating_duration_since(Instant::now()) } else { IDLE }
    }

    /// Takes the commands that have come.
    fn take(&mut self) {
        let room = MOST_WAITING.saturating_sub(self.waiting.len());
        self.waiting.extend(self.commands.try_iter().take(room));
    }

    /// The time between frames.
    fn interval(&self) -> Duration {
        self.speed.map_or(Duration::ZERO, |speed| Duration::from_secs_f64(self.show.dt() / speed))
    }

    /// The next frame, or a later one where frames can be left out and this one comes too late.
    fn go_on(&mut self) {
        let (now, interval) = (Instant::now(), self.interval());
        let late = (now - self.due).as_secs_f64() / interval.as_secs_f64();
        let frames = if self.show.can_skip() && late < MOST_BEHIND { 1 + late as u32 } else { 1 };
        // What lags is not made up for.
        self.due = (self.due + interval * frames).max(now);
        if let Err(error) = self.show.advance(frames.into()) {
            self.playing = false;
            self.say(true, one_line(&error));
        }
        self.playing &= !self.show.is_over();
        self.publish();
    }

    /// Carries out what waits.
    fn obey_all(&mut self) {
        let mut is_published = true;
        while let Some(command) = self.waiting.pop_front() {
            if self.waiting.front().is_some_and(|later| command.is_replaced_by(later)) {
                continue;
            }
            if let Err(error) = self.obey(&command) {
                self.say(true, one_line(&error));
            }
            is_published = match command {
                // Who comes is given what there is.
                Command::Look => is_published,
                Command::Step { .. } => {
                    self.publish();
                    true
                }
                _ => false,
            };
        }
        if !is_published {
            self.publish();
        }
    }

    fn obey(&mut self, command: &Command) -> Result<()> {
        match *command {
            Command::Play => {
                if self.show.is_over() {
                    self.show.obey(&Command::Reset)?;
                }
                self.playing = !self.show.is_over();
                self.due = Instant::now() + self.interval();
            }
            Command::Pause => self.playing = false,
            Command::Step { by } => self.step(by)?,
            Command::Speed { factor } => {
                if let Some(factor) = factor.filter(|factor| !SPEEDS.contains(factor)) {
                    bail!("speed {factor}, expected {} to {}", SPEEDS.start(), SPEEDS.end());
                }
                self.speed = factor;
                self.due = Instant::now() + self.interval();
            }
            Command::Look => {
                // The first frame is seen from now on.
                self.is_seen = true;
                self.due = Instant::now() + self.interval();
            }
            Command::Refresh => {}
            _ => {
                self.show.obey(command)?;
                if *command == Command::Reset {
                    self.due = Instant::now() + self.interval();
                }
            }
        }
        Ok(())
    }

    /// So many frames on, or back, and stands still.
    fn step(&mut self, by: i32) -> Result<()> {
        self.playing = false;
        if by < 0 || self.show.can_skip() {
            return self.show.advance(by.into());
        }
        if by == 0 {
            return Ok(());
        }
        self.show.advance(1)?;
        // Each step may take seconds: the others come next, unless somebody has thought better of it.
        self.take();
        let ends = |command: &Command| matches!(command, Command::Play | Command::Pause | Command::Reset);
        if by > 1 && !self.show.is_over() && !self.waiting.iter().any(ends) {
            self.waiting.push_front(Command::Step { by: by - 1 });
        }
        Ok(())
    }

    fn say(&mut self, is_error: bool, text: String) {
        let number = self.message.as_ref().map_or(0, |message| message.number) + 1;
        self.message = Some(Message { number, is_error, text });
    }

    fn publish(&mut self) {
        let frame = self.show.frame(self.server.wants_density());
        self.server.publish_frame(&frame);
        if let Some(news) = self.show.news() {
            self.say(false, news);
        }
        let state = self.show.describe();
        let (playing, speed, message) = (self.playing, self.speed, self.message.clone());
        self.server.publish_state(&State { playing, speed, message, ..state });
    }
}

/// A state that says nothing.
pub fn blank(mode: Mode) -> State {
    State {
        kind: "state",
        title: String::new(),
        mode,
        playing: false,
        speed: None,
        stored: None,
        dt: 0.0,
        particle_radius: 0.0,
        up: [0.0, 1.0, 0.0],
        gravity: [0.0; 3],
        scene_gravity: [0.0; 3],
        viscosity: None,
        viscosities: None,
        has_speeds: true,
        has_bodies: true,
        panels: Vec::new(),
        solvers: Vec::new(),
        emitters: Vec::new(),
        recording: None,
        message: None,
    }
}

#[cfg(test)]
mod tests {
    use std::net::{Ipv4Addr, SocketAddr};

    use fluvia_view::walls::Walls;

    use super::*;

    /// Ten frames without particles; says no to changes of gravity.
    struct Ten {
        at: i64,
        skips: bool,
        sought: Vec<usize>,
        shown: Vec<i64>,
    }

    impl Show for Ten {
        fn walls(&self) -> Walls {
            Walls::default()
        }

        fn dt(&self) -> f64 {
            0.02
        }

        fn can_skip(&self) -> bool {
            self.skips
        }

        fn advance(&mut self, frames: i64) -> Result<()> {
            self.at = (self.at + frames).clamp(0, 9);
            Ok(())
        }

        fn is_over(&self) -> bool {
            self.at == 9
        }

        fn obey(&mut self, command: &Command) -> Result<()> {
            match command {
                Command::Reset => self.at = 0,
                Command::Seek { index } => self.sought.push(*index),
                _ => bail!("no"),
            }
            Ok(())
        }

        fn news(&mut self) -> Option<String> {
            None
        }

        fn frame(&mut self, _: bool) -> Frame<'_> {
            self.shown.push(self.at);
            Frame { number: self.at as u64, ..Frame::default() }
        }

        fn describe(&self) -> State {
            blank(Mode::Playback)
        }
    }

    fn stage(skips: bool) -> Stage<Ten> {
        let (server, commands) = Server::start(SocketAddr::from((Ipv4Addr::LOCALHOST, 0))).unwrap();
        Stage::new(server, commands, Ten { at: 0, skips, sought: Vec::new(), shown: Vec::new() }, true)
    }

    /// Obeys what came at once.
    fn obey<const N: usize>(stage: &mut Stage<Ten>, commands: [Command; N]) {
        stage.waiting.extend(commands);
        stage.obey_all();
    }

    #[test]
    fn time_begins_when_somebody_looks() {
        let mut stage = stage(true);
        assert!(!stage.passes() && stage.wait() == IDLE);
        // Who looks at a frame that has waited for an hour sees that one first.
        stage.due = Instant::now() - Duration::from_secs(3600);
        obey(&mut stage, [Command::Look]);
        assert!(stage.passes() && stage.due > Instant::now());
        assert!(stage.wait() <= stage.interval());
        assert_eq!(stage.show.shown, [0; 0], "what is there is given to who comes");
        // It stands still until somebody presses play where it was told to.
        stage.is_seen = false;
        stage.playing = false;
        obey(&mut stage, [Command::Look]);
        assert!(!stage.passes());
    }

    #[test]
    fn every_step_is_shown_until_somebody_thinks_better_of_it() {
        let step = |by| Command::Step { by };
        let mut slow = stage(false);
        obey(&mut slow, [step(3), step(1), step(0)]);
        assert_eq!(slow.show.shown, [1, 2, 3, 4, 4]);
        assert!(!slow.playing);
        obey(&mut slow, [step(5), Command::Pause]);
        assert_eq!(slow.show.at, 5);
        // There is an end to it.
        slow.show.shown.clear();
        obey(&mut slow, [step(i32::MAX)]);
        assert_eq!(slow.show.shown, [6, 7, 8, 9]);
        // Where frames can be left out one is sought.
        let mut fast = stage(true);
        obey(&mut fast, [step(3), step(1), step(-2)]);
        assert_eq!(fast.show.shown, [3, 4, 2]);
    }

    #[test]
    fn late_frames_are_left_out_where_they_can_be() {
        for (skips, shown) in [(true, 4), (false, 1)] {
            let mut stage = stage(skips);
            // Three frames and a half too late.
            stage.due = Instant::now() - Duration::from_millis(70);
            stage.go_on();
            assert_eq!(stage.show.at, shown);
            assert!(stage.due + Duration::from_millis(1) > Instant::now());
        }
        // A machine that slept for an hour.
        let mut slept = stage(true);
        slept.due = Instant::now() - Duration::from_secs(3600);
        slept.go_on();
        assert_eq!(slept.show.at, 1);
        // As fast as possible: every frame, at once.
        let mut fast = stage(true);
        fast.speed = None;
        for at in 1..9 {
            fast.go_on();
            assert_eq!((fast.show.at, fast.playing), (at, true));
        }
        fast.go_on();
        assert!(!fast.playing, "it is over");
        fast.obey(&Command::Play).unwrap();
        assert_eq!((fast.show.at, fast.playing), (0, true));
    }

    #[test]
    fn of_a_row_of_wishes_the_last_counts_and_what_fails_is_said() {
        let mut stage = stage(true);
        let seek = |index| Command::Seek { index };
        let gravity = Command::Gravity { to: [0.0; 3] };
        let commands =
            [seek(1), seek(2), Command::Step { by: 1 }, seek(3), gravity.clone(), gravity, seek(4)];
        obey(&mut stage, commands);
        assert_eq!((stage.show.sought.as_slice(), stage.show.at), (&[2, 3, 4][..], 1));
        assert!(!stage.playing, "a step stands still");
        let message = stage.message.clone().unwrap();
        assert_eq!((message.number, message.is_error, message.text.as_str()), (1, true, "no"));
        for factor in [0.0, -1.0, 1e9] {
            assert!(stage.obey(&Command::Speed { factor: Some(factor) }).is_err());
        }
        stage.obey(&Command::Speed { factor: None }).unwrap();
        assert_eq!((stage.speed, stage.interval()), (None, Duration::ZERO));
    }
}
