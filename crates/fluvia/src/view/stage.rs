//! The thread that decides what everybody sees: it keeps time, obeys, and publishes.
//!
//! Commands are carried out in the order in which they came, and between the steps of a row. Every step is published, so that
//! a row is seen as such.

use std::sync::Arc;
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

/// Without a next frame: how long to wait for commands at a time. No frame stays longer.
const IDLE: Duration = Duration::from_secs(3600);

/// Frames that are left out at a time at most: more is no lag but a machine that slept.
const MOST_BEHIND: f64 = 100.0;

/// Commands that are carried out at most before time passes again.
const MOST_TAKEN: usize = 64;

/// The thread's state.
pub struct Stage<S> {
    server: Arc<Server>,
    commands: Receiver<Command>,
    show: S,
    playing: bool,
    /// What is left of a row of steps. Each may take seconds, and somebody may think better of it meanwhile.
    steps: u32,
    /// Whether anybody has come to look: time does not pass before.
    is_seen: bool,
    /// Simulated seconds in a second; none: as fast as possible.
    speed: Option<f64>,
    /// When the next frame is due.
    due: Instant,
    message: Option<Message>,
}

impl<S: Show> Stage<S> {
    pub fn new(server: Arc<Server>, commands: Receiver<Command>, show: S, playing: bool) -> Stage<S> {
        Stage {
            server,
            commands,
            show,
            playing,
            steps: 0,
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
            self.turn();
        }
    }

    /// Obeys what has come, and shows a frame if one is due.
    fn turn(&mut self) {
        // Else nothing came in time: the other end is with the server, which is ours.
        if let Ok(first) = self.commands.recv_timeout(self.wait()) {
            let others = self.commands.try_iter().take(MOST_TAKEN);
            let commands: Vec<Command> = std::iter::once(first).chain(others).collect();
            self.obey_all(commands);
        }
        if self.steps > 0 {
            self.steps -= 1;
            self.go_on(1);
        } else if self.passes() && self.due <= Instant::now() {
            let frames = self.frames_due();
            self.go_on(frames);
        }
    }

    /// Whether time passes.
    fn passes(&self) -> bool {
        self.playing && self.is_seen
    }

    /// How long there is nothing to do but to obey.
    fn wait(&self) -> Duration {
        if self.steps > 0 {
            Duration::ZERO
        } else if self.passes() {
            self.due.saturating_duration_since(Instant::now())
        } else {
            IDLE
        }
    }

    /// The time between frames.
    fn interval(&self) -> Duration {
        self.speed.map_or(Duration::ZERO, |speed| {
            Duration::try_from_secs_f64(self.show.dt() / speed).map_or(IDLE, |interval| interval.min(IDLE))
        })
    }

    /// One frame, or more where frames can be left out and the next one comes too late.
    fn frames_due(&mut self) -> u32 {
        let (now, interval) = (Instant::now(), self.interval());
        let late = (now - self.due).as_secs_f64() / interval.as_secs_f64();
        let frames = if self.show.can_skip() && late < MOST_BEHIND { 1 + late as u32 } else { 1 };
        // What lags is not made up for.
        self.due = (self.due + interval * frames).max(now);
        frames
    }

    /// So many frames on.
    fn go_on(&mut self, frames: u32) {
        if let Err(error) = self.show.advance(frames.into()) {
            (self.playing, self.steps) = (false, 0);
            self.say(true, one_line(&error));
        }
        if self.show.is_over() {
            (self.playing, self.steps) = (false, 0);
        }
        self.publish();
    }

    /// Carries out commands; of a row that replace one another the last.
    fn obey_all(&mut self, commands: Vec<Command>) {
        let mut is_published = true;
        for (k, command) in commands.iter().enumerate() {
            if commands.get(k + 1).is_some_and(|later| command.is_replaced_by(later)) {
                continue;
            }
            if let Err(error) = self.obey(command) {
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
                (self.playing, self.steps) = (!self.show.is_over(), 0);
                self.due = Instant::now() + self.interval();
            }
            Command::Pause => (self.playing, self.steps) = (false, 0),
            Command::Step { by } => self.step(by)?,
            Command::Speed { factor } => {
                if let Some(factor) = factor.filter(|factor| !SPEEDS.contains(factor)) {
                    bail!("speed {factor}, expected {} to {}", SPEEDS.start(), SPEEDS.end());
                }
                self.speed = factor;
                // What is due sooner stays so, or nothing would move while a slow speed is chosen.
                self.due = self.due.min(Instant::now() + self.interval());
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
                    self.steps = 0;
                    self.due = Instant::now() + self.interval();
                }
            }
        }
        Ok(())
    }

    /// So many frames on, or back, and stands still.
    fn step(&mut self, by: i32) -> Result<()> {
        if by < 0 || self.show.can_skip() {
            self.show.advance(by.into())?;
        } else if by > 0 {
            self.show.advance(1)?;
            self.steps = if self.show.is_over() { 0 } else { self.steps.saturating_add_signed(by - 1) };
        }
        self.playing = false;
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

    /// Frames without particles; says no to changes of gravity.
    struct Frames {
        at: i64,
        last: i64,
        dt: f64,
        skips: bool,
        sought: Vec<usize>,
        shown: Vec<i64>,
    }

    impl Show for Frames {
        fn walls(&self) -> Walls {
            Walls::default()
        }

        fn dt(&self) -> f64 {
            self.dt
        }

        fn can_skip(&self) -> bool {
            self.skips
        }

        fn advance(&mut self, frames: i64) -> Result<()> {
            if frames < 0 && !self.skips {
                bail!("not back");
            }
            self.at = (self.at + frames).clamp(0, self.last);
            Ok(())
        }

        fn is_over(&self) -> bool {
            self.at == self.last
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

    /// Of ten frames.
    fn stage(skips: bool) -> Stage<Frames> {
        let (server, commands) = Server::start(SocketAddr::from((Ipv4Addr::LOCALHOST, 0))).unwrap();
        let show = Frames { at: 0, last: 9, dt: 0.02, skips, sought: Vec::new(), shown: Vec::new() };
        Stage::new(Arc::new(server), commands, show, true)
    }

    /// Obeys what came at once, and takes the steps that were asked for.
    fn obey<const N: usize>(stage: &mut Stage<Frames>, commands: [Command; N]) {
        stage.obey_all(commands.to_vec());
        while stage.steps > 0 {
            stage.turn();
        }
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
        assert_eq!(slow.show.shown, [1, 2, 2, 3, 4]);
        assert!(!slow.playing);
        obey(&mut slow, [step(5), Command::Pause]);
        assert_eq!(slow.show.at, 5);
        // What is refused changes nothing.
        slow.playing = true;
        obey(&mut slow, [step(-1)]);
        assert!(slow.playing && slow.message.take().is_some());
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
    fn whoever_asks_for_many_steps_locks_nobody_out() {
        let mut stage = stage(false);
        stage.show.last = i64::MAX;
        let (sender, commands) = std::sync::mpsc::channel();
        stage.commands = commands;
        sender.send(Command::Step { by: 1000 }).unwrap();
        for k in 0..70 {
            sender.send(Command::Gravity { to: [k as f32, 0.0, 0.0] }).unwrap();
            sender.send(Command::Seek { index: k }).unwrap();
        }
        sender.send(Command::Pause).unwrap();
        stage.turn();
        while stage.steps > 0 && stage.show.at < 10 {
            stage.turn();
        }
        assert_eq!((stage.show.sought.len(), stage.steps), (70, 0));
        assert!(stage.show.at < 10, "{}", stage.show.at);
    }

    #[test]
    fn frames_that_are_ages_apart_are_waited_for() {
        let mut stage = stage(true);
        stage.is_seen = true;
        for dt in [1e30, f64::MAX] {
            stage.show.dt = dt;
            for command in [Command::Speed { factor: Some(0.01) }, Command::Play, Command::Reset] {
                stage.obey(&command).unwrap();
                assert!(stage.wait() <= IDLE);
            }
            stage.due = Instant::now();
            assert_eq!(stage.frames_due(), 1);
        }
    }

    #[test]
    fn late_frames_are_left_out_where_they_can_be() {
        let pass = |stage: &mut Stage<Frames>| {
            let frames = stage.frames_due();
            stage.go_on(frames);
        };
        for (skips, shown) in [(true, 4), (false, 1)] {
            let mut stage = stage(skips);
            // Three frames and a half too late.
            stage.due = Instant::now() - Duration::from_millis(70);
            pass(&mut stage);
            assert_eq!(stage.show.at, shown);
            assert!(stage.due + Duration::from_millis(1) > Instant::now());
        }
        // A machine that slept for an hour.
        let mut slept = stage(true);
        slept.due = Instant::now() - Duration::from_secs(3600);
        pass(&mut slept);
        assert_eq!(slept.show.at, 1);
        // As fast as possible: every frame, at once.
        let mut fast = stage(true);
        fast.speed = None;
        for at in 1..9 {
            pass(&mut fast);
            assert_eq!((fast.show.at, fast.playing), (at, true));
        }
        pass(&mut fast);
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
