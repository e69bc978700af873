"""Every experiment, in the order of the paper; then our own."""

from recon.study.assumptions_study import assumptions
from recon.study.correspondence_study import correspondence
from recon.study.experiment import Experiment
from recon.study.integration_study import integration
from recon.study.noise_studies import noise_by_baseline, noise_by_index
from recon.study.photo_studies import bottle, concave, hemisphere, ornament, plates
from recon.study.resolution import resolution
from recon.study.thin_studies import cone_by_padding, shell_by_shift
from recon.study.total_reflection import total_reflection

EXPERIMENTS = (
    Experiment("noise-baseline", "Noise against baseline", noise_by_baseline),
    Experiment("noise-liquid", "Noise against the liquid's index", noise_by_index),
    Experiment("concave", "A concave object", concave),
    Experiment("thin-cone", "Thin cone: padding and noise", cone_by_padding),
    Experiment("thin-shell", "Thin shell: shift and noise", shell_by_shift),
    Experiment("total-reflection", "Total internal reflection", total_reflection),
    Experiment("hemisphere", "Twin of the hemisphere", hemisphere),
    Experiment("ornament", "Twin of the ornament", ornament),
    Experiment("bottle", "Twin of the bottle", bottle),
    Experiment("plates", "Twins of the thin glass plates", plates),
    Experiment("correspondence", "Correspondence against its bound", correspondence),
    Experiment("assumptions", "Wrong assumptions", assumptions),
    Experiment("resolution", "Ripples and a step: what is resolved", resolution),
    Experiment("integration", "Integration of normals alone", integration),
)
