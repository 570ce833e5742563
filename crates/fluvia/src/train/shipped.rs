//! The settings that come with the program: the files of assets/configs, by name.

const SHIPPED: [(&str, &str); 14] = [
    ("paper", include_str!("../../../../assets/configs/paper.toml")),
    ("published", include_str!("../../../../assets/configs/published.toml")),
    ("two-cores", include_str!("../../../../assets/configs/two-cores.toml")),
    ("two-cores-rollouts", include_str!("../../../../assets/configs/two-cores-rollouts.toml")),
    ("two-cores-viscosity", include_str!("../../../../assets/configs/two-cores-viscosity.toml")),
    ("two-cores-viscosity-steps", include_str!("../../../../assets/configs/two-cores-viscosity-steps.toml")),
    ("box-6k", include_str!("../../../../assets/configs/box-6k.toml")),
    ("viscosity", include_str!("../../../../assets/configs/viscosity.toml")),
    ("dam-break", include_str!("../../../../assets/configs/dam-break.toml")),
    ("without-interpolation", include_str!("../../../../assets/configs/without-interpolation.toml")),
    ("without-window", include_str!("../../../../assets/configs/without-window.toml")),
    ("triangular-window", include_str!("../../../../assets/configs/triangular-window.toml")),
    ("naive-loss", include_str!("../../../../assets/configs/naive-loss.toml")),
    ("without-fc", include_str!("../../../../assets/configs/without-fc.toml")),
];

/// The text of the settings of that name.
pub fn text(name: &str) -> Option<&'static str> {
    SHIPPED.iter().find(|(shipped, _)| *shipped == name).map(|(_, text)| *text)
}

/// All names.
pub fn names() -> impl Iterator<Item = &'static str> {
    SHIPPED.iter().map(|(name, _)| *name)
}
