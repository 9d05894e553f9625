//! Named choices of the command line, one enum for each enum of a library.

use clap::ValueEnum;

/// Defines a `ValueEnum` with the variants of a library's enum, and its conversion to it.
macro_rules! names {
    ($(#[$meta:meta])* $name:ident for $target:path { $($(#[$doc:meta])* $variant:ident,)+ }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
        pub enum $name {
            $($(#[$doc])* $variant,)+
        }

        impl From<$name> for $target {
            fn from(name: $name) -> Self {
                match name {
                    $($name::$variant => Self::$variant,)+
                }
            }
        }
    };
}

names! {
    /// Trade-off of training time against quality.
    PresetName for heliosplat_fitting::settings::Preset {
        /// Seconds, to check cameras, altitudes and suns (satellite scenes).
        Preview,
        /// A first look.
        Fast,
        /// The default.
        Balanced,
        /// Smaller errors.
        Accurate,
        /// Smallest errors, twice the time of accurate (satellite scenes).
        Best,
    }
}

names! {
    /// A model of mean sea level.
    GeoidName for heliosplat_raster::Geoid {
        /// EGM96, on a grid of 15 minutes.
        Egm96,
        /// EGM2008, on a grid of 2.5 minutes.
        Egm2008,
    }
}

names! {
    /// Preferred source of an image's camera; if the image has none of this kind, the next one counts.
    RpcName for heliosplat_scene::RpcPreference {
        /// A Sat-NeRF JSON, then the file beside the image, then its tag
        Json,
        /// The file beside the image, then its tag; the tag of a crop comes before the file of the whole image
        Image,
        /// The file beside the image: RPB, _RPC.TXT, XML, .aux.xml
        Sidecar,
        /// The tag in the image
        Tag,
    }
}

names! {
    /// Registration of a prediction to the truth before it is measured.
    ProtocolName for heliosplat_evaluate::Protocol {
        /// None.
        Raw,
        /// Integer shift and mean height; water left out of both.
        Aligned,
        /// Integer shift and mean height; water left out of the metric.
        AlignedWater,
        /// Sub-pixel shift and mean height; water left out of both.
        Subpixel,
    }
}

names! {
    /// Error model of a camera.
    BiasName for heliosplat_rpc::adjust::BiasModel {
        /// A shift of the whole image
        Translation,
        /// A shift that changes linearly over the image: rotation, scale, drift
        Affine,
    }
}
