//! The settings of a training, as they are in a configuration file (TOML).

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use cconv::{Interpolation, PositionGradient, Window};
use fluvia_net::adam;
use fluvia_net::config::{Config as NetworkConfig, Integration};
use fluvia_net::dataset::{Damaged, FreeFall, Noise, Sampling};
use fluvia_net::loss::Loss;
use fluvia_net::train::{Options, Schedule};
use fluvia_net::unroll::Storage;
use fluvia_net::weights::Weights;
use fluvia_sim::frames::sequence;
use serde::{Deserialize, Serialize};

mod check;

use super::names::{IntegrationName, InterpolationName, WindowName};
use super::shipped;
use crate::options::PrecisionName;
use crate::record::or_shipped;

/// A configuration file. What a file does not say is as in the published training, but for the integration.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    pub data: Data,
    pub network: Network,
    pub loss: LossSettings,
    pub training: Training,
    pub rate: Rate,
    pub optimizer: Optimizer,
    pub validation: Validation,
}

/// Where the data are; relative paths are relative to the working directory.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Data {
    /// The folders of the training sequences.
    pub train: Vec<PathBuf>,
    /// The folders of the validation sequences.
    pub valid: Vec<PathBuf>,
}

/// The network that is trained, and what its data are of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Network {
    pub integration: IntegrationName,
    /// Channels of each of the three parts of the first layer.
    pub first: usize,
    /// Channels of the layers between the first and the last.
    pub hidden: Vec<usize>,
    /// How filters are looked up between their cells.
    pub interpolation: InterpolationName,
    /// The window function of the convolutions.
    pub window: WindowName,
    /// Whether each particle has a fully connected part of its own.
    pub fully_connected: bool,
    /// Whether the viscosity of a particle is an input.
    pub viscosity: bool,
    /// Seconds between frames.
    pub dt: f32,
    /// Metres per second squared.
    pub gravity: [f32; 3],
}

impl Default for Network {
    fn default() -> Network {
        let NetworkConfig { dt, gravity, .. } = NetworkConfig::default();
        Network {
            integration: IntegrationName::Velocity,
            first: 32,
            hidden: vec![64, 64],
            interpolation: InterpolationName::Linear,
            window: WindowName::Poly6,
            fully_connected: true,
            viscosity: false,
            dt,
            gravity,
        }
    }
}

/// Eq. 16.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LossSettings {
    /// c, neighbours; 0 counts all particles alike.
    pub neighbors: f32,
    /// γ.
    pub exponent: f32,
    /// Whether velocities count beside positions; as a rule where the network corrects them.
    pub velocity: Option<bool>,
    /// How much compression counts.
    pub compression: f32,
    /// How much particles in walls count.
    pub walls: f32,
}

impl Default for LossSettings {
    fn default() -> LossSettings {
        let Loss { neighbor_scale, exponent, compression, walls, .. } = Loss::default();
        let neighbors = neighbor_scale.unwrap_or_default();
        LossSettings { neighbors, exponent, velocity: None, compression, walls }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Training {
    /// Weights to begin with, if not random ones: a file, or the name of shipped ones.
    pub weights: Option<PathBuf>,
    /// Updates of the weights.
    pub updates: u64,
    /// Windows of a batch.
    pub batch: usize,
    /// Steps of the network in a window.
    pub steps: usize,
    /// The most steps before those, without gradient: a batch has 0 or more. A network then learns from its own states.
    pub lead: usize,
    /// Seed of the first weights, of the order of the data and of rotations.
    pub seed: u64,
    /// Whether windows are turned about the axis of gravity at random.
    pub rotate: bool,
    /// The standard deviation of normal noise on every coordinate of the positions that windows start from, metres.
    pub position_noise: f32,
    /// The same of velocities, metres per second.
    pub velocity_noise: f32,
    /// Particles that fall freely in every batch, as one cloud more.
    pub free_particles: usize,
    pub precision: PrecisionName,
    /// How much of the averaged weights stays in an update; 0 averages nothing.
    pub average: f32,
    /// Whether gradients go through the positions inside the network.
    pub positions: bool,
    /// Whether activations are computed again for the backward pass: less memory for many steps.
    pub recompute: bool,
    /// Parts of sequences that are together in memory.
    pub group: usize,
}

impl Default for Training {
    fn default() -> Training {
        Training {
            weights: None,
            updates: 50_000,
            batch: 16,
            steps: 2,
            lead: 0,
            seed: 0,
            rotate: true,
            position_noise: 0.0,
            velocity_noise: 0.0,
            free_particles: 0,
            precision: PrecisionName::F32,
            average: 0.0,
            positions: false,
            recompute: false,
            group: 16,
        }
    }
}

/// The rate of learning.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, tag = "kind", rename_all = "lowercase")]
pub enum Rate {
    /// That of the paper: 1e-3, halved at 20,000, 25,000, ... 45,000 of 50,000 updates, of others in proportion.
    Paper {},
    /// That of the published scripts, which halve first at 25,000.
    Published {},
    /// Multiplied by a factor at some updates.
    Steps { highest: f32, factor: f32, at: Vec<u64> },
    /// Rises linearly for some updates, falls to zero along half a cosine.
    Cosine { highest: f32, warmup: u64 },
}

impl Default for Rate {
    fn default() -> Rate {
        Rate::Published {}
    }
}

/// Adam.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Optimizer {
    pub beta1: f32,
    pub beta2: f32,
    pub epsilon: f32,
    /// How many times the rate of all others the weights of the viscosity have, where it is an input: its values are small.
    pub viscosity_rate: f32,
}

impl Default for Optimizer {
    fn default() -> Optimizer {
        let adam::Params { beta1, beta2, epsilon } = adam::Params::default();
        Optimizer { beta1, beta2, epsilon, viscosity_rate: 1.0 }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Validation {
    /// Updates from one validation to the next.
    pub every: u64,
    /// Windows that it takes, evenly from all there are.
    pub windows: usize,
}

impl Default for Validation {
    fn default() -> Validation {
        Validation { every: 500, windows: 64 }
    }
}

/// Room around the fluid of a window within which wall particles are kept beside the filter radius, metres: predictions
/// are not exact.
const WALL_SLACK: f32 = 0.2;

impl Data {
    /// The folders of some data sets; one without validation scenes has none.
    pub fn of(sets: &[PathBuf]) -> Data {
        let in_each = |name: &str| sets.iter().map(|set| set.join(name)).collect::<Vec<_>>();
        let has_scenes = |folder: &PathBuf| sequence::find(folder).is_ok_and(|found| !found.is_empty());
        let valid = in_each("valid").into_iter().filter(has_scenes).collect();
        Data { train: in_each("train"), valid }
    }
}

impl Config {
    /// Reads the configuration file of that path, or the shipped one of that name.
    ///
    /// # Errors
    /// If it cannot be read or parsed, has an unknown key, or a value is out of range.
    pub fn load(name: &str) -> Result<Config> {
        let path = Path::new(name);
        let text = match (shipped::text(name), std::fs::read_to_string(path)) {
            (_, Ok(text)) => text,
            (Some(text), Err(_)) => text.to_owned(),
            (None, Err(error)) => {
                let error = anyhow::Error::new(error).context(name.to_owned());
                return Err(or_shipped(error, path, "settings", shipped::names()));
            }
        };
        Config::parse(&text).with_context(|| name.to_owned())
    }

    fn parse(text: &str) -> Result<Config> {
        let config: Config = toml::from_str(text).map_err(|error| {
            let line = error.span().map(|span| 1 + text[..span.start].matches('\n').count());
            let line = line.map_or(String::new(), |line| format!("line {line}: "));
            anyhow::anyhow!("{line}{}", error.message())
        })?;
        config.check()?;
        Ok(config)
    }

    /// What the network is made for.
    pub fn made_for(&self) -> NetworkConfig {
        let Network { integration, viscosity, dt, gravity, .. } = &self.network;
        NetworkConfig {
            interpolation: match self.network.interpolation {
                InterpolationName::Linear => Interpolation::Linear,
                InterpolationName::Nearest => Interpolation::Nearest,
            },
            window: match self.network.window {
                WindowName::Poly6 => Window::Poly6,
                WindowName::Triangular => Window::Triangular,
                WindowName::None => Window::None,
            },
            fully_connected: self.network.fully_connected,
            extra_inputs: if *viscosity { vec!["viscosity".into()] } else { Vec::new() },
            dt: *dt,
            gravity: *gravity,
            integration: match integration {
                IntegrationName::Paper => Integration::Paper,
                IntegrationName::Velocity => Integration::Velocity,
            },
            ..NetworkConfig::default()
        }
    }

    /// The weights that the training begins with.
    pub fn first_weights(&self) -> Weights {
        let Network { first, hidden, .. } = &self.network;
        Weights::random(self.made_for(), *first, hidden, self.training.seed)
    }

    pub fn options(&self) -> Options {
        let Config { loss, training, optimizer, .. } = self;
        Options {
            loss: Loss {
                neighbor_scale: (loss.neighbors > 0.0).then_some(loss.neighbors),
                exponent: loss.exponent,
                velocity: loss.velocity.unwrap_or(self.network.integration == IntegrationName::Velocity),
                compression: loss.compression,
                walls: loss.walls,
            },
            schedule: match &self.rate {
                Rate::Paper {} => Schedule::paper(training.updates),
                Rate::Published {} => Schedule::published(training.updates),
                Rate::Steps { highest, factor, at } => {
                    Schedule::Steps { rate: *highest, factor: *factor, at: at.clone() }
                }
                &Rate::Cosine { highest, warmup } => {
                    Schedule::Cosine { rate: highest, warmup, updates: training.updates }
                }
            },
            adam: adam::Params { beta1: optimizer.beta1, beta2: optimizer.beta2, epsilon: optimizer.epsilon },
            average: (training.average > 0.0).then_some(training.average),
            positions: if training.positions { PositionGradient::Full } else { PositionGradient::Stop },
            storage: if training.recompute { Storage::Recompute } else { Storage::Keep },
            precision: training.precision.into(),
            extra_input_rate: optimizer.viscosity_rate,
        }
    }

    pub fn sampling(&self, damaged: Damaged) -> Sampling {
        let Network { gravity, dt, .. } = self.network;
        let Training { seed, batch, steps, lead, group, rotate, position_noise, velocity_noise, .. } =
            self.training;
        Sampling {
            seed,
            batch,
            steps,
            lead,
            group,
            axis: rotate.then_some(self.network.gravity),
            noise: Noise { position: position_noise, velocity: velocity_noise },
            free: FreeFall { count: self.training.free_particles, gravity, dt },
            viscosity: self.network.viscosity,
            reach: NetworkConfig::default().filter_radius + WALL_SLACK,
            damaged,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_file_does_not_say_is_published_but_for_the_integration() {
        let config = Config::parse("").unwrap();
        assert_eq!(config, Config::default());
        assert_eq!((config.training.updates, config.training.batch), (50_000, 16));
        assert_eq!(config.options().schedule, Schedule::published(50_000));
        assert_eq!(config.made_for().integration, Integration::Velocity);
        assert!(config.options().loss.velocity);
        // As it is recorded.
        let value = serde_json::to_value(&config).unwrap();
        assert_eq!(serde_json::from_value::<Config>(value).unwrap(), config);
    }

    #[test]
    fn the_shipped_files_are_settings() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/configs");
        for (name, exponent) in [("paper", 0.5), ("published", 0.5), ("naive-loss", 1.0)] {
            let config = Config::load(name).unwrap();
            assert_eq!(config.made_for().integration, Integration::Paper);
            let found = config.options().loss;
            assert_eq!(found, Loss { exponent, neighbor_scale: found.neighbor_scale, ..Loss::default() });
        }
        assert_eq!(Config::load("viscosity").unwrap().options().extra_input_rate, 1.0);
        assert_eq!(Config::load("two-cores-viscosity").unwrap().options().extra_input_rate, 20.0);
        let mut files: Vec<String> = std::fs::read_dir(&folder)
            .unwrap()
            .map(|entry| entry.unwrap().path().file_stem().unwrap().to_string_lossy().into_owned())
            .collect();
        for name in &files {
            let config = Config::load(name).unwrap();
            config.first_weights().check().unwrap();
            let path = folder.join(format!("{name}.toml"));
            assert_eq!(Config::load(path.to_str().unwrap()).unwrap(), config);
        }
        files.sort();
        let mut shipped: Vec<_> = shipped::names().collect();
        shipped.sort_unstable();
        assert_eq!(files, shipped);
    }

    #[test]
    fn schedules_shrink_with_the_updates() {
        for rate in [
            Rate::Paper {},
            Rate::Steps { highest: 0.1, factor: 0.5, at: vec![20_000, 40_000] },
            Rate::Cosine { highest: 0.1, warmup: 10_000 },
        ] {
            let whole = Config { rate, ..Config::default() };
            let mut tenth = whole.clone();
            tenth.set_updates(5_000);
            tenth.check().unwrap();
            for update in [0u64, 500, 1_000, 2_500, 3_999, 4_999] {
                let (a, b) =
                    (tenth.options().schedule.rate(update), whole.options().schedule.rate(10 * update));
                assert!((a - b).abs() < 2e-4 * (1.0 + b), "{:?} {update}: {a} and {b}", whole.rate);
            }
        }
    }

    #[test]
    fn faults_name_the_key() {
        for (text, words) in [
            ("[training]\nupdate = 5", vec!["line 2", "`update`", "`updates`"]),
            ("[training]\nupdates = 0", vec!["`training.updates`", "at least 1"]),
            ("[training]\nupdates = -1", vec!["line 2"]),
            ("[loss]\nexponent = nan", vec!["`loss.exponent`"]),
            ("[optimizer]\nbeta2 = 1.0", vec!["`optimizer.beta2`", "below 1"]),
            ("[optimizer]\nviscosity_rate = 20.0", vec!["`optimizer.viscosity_rate`", "`network.viscosity`"]),
            ("[rate]\nkind = \"linear\"", vec!["linear", "cosine"]),
            ("[rate]\nkind = \"paper\"\nhighest = 5e-3", vec!["`highest`"]),
            (
                "[training]\nupdates = 9\n[rate]\nkind = \"cosine\"\nhighest = 1.0\nwarmup = 9",
                vec!["`rate.warmup`", "below"],
            ),
            ("[network]\nintegration = \"paper\"\n[loss]\nvelocity = true", vec!["`loss.velocity`", "paper"]),
            (
                "[rate]\nkind = \"steps\"\nhighest = 1.0\nfactor = 0.5\nat = [1000, 50000]",
                vec!["`rate.at`", "50000", "below"],
            ),
            ("[training]\nposition_noise = -1.0", vec!["`training.position_noise`", "at least 0"]),
            ("[network]\nwindow = \"cubic\"", vec!["line 2", "cubic", "triangular"]),
            ("[network]\nhidden = [64, 0]", vec!["`network.hidden`"]),
            ("[network", vec!["line 1"]),
        ] {
            let fault = format!("{:#}", Config::parse(text).unwrap_err());
            assert!(words.iter().all(|word| fault.contains(word)), "{text:?}: {fault}");
            assert_eq!(fault.lines().count(), 1, "{fault}");
        }
    }
}
