"""Public machines that we did not build: where their records are, what a person types, what is published."""

from collections.abc import Mapping
from dataclasses import dataclass, field

JOINT = '[mechanism]\nmodel = "joint1"\nactuated = [1]\n'


@dataclass(frozen=True)
class Machine:
    """A repository, its records, what a person types, and what the authors publish."""

    title: str
    repository: str
    commit: str
    licence: str
    files: Mapping[str, str]
    """Name that a person gives -> path in the repository."""
    rig: str
    commands: tuple[str, ...]
    """At most five."""
    published: Mapping[str, float]
    """Of the parameters in fit.json."""
    source: str
    """Of what is published."""
    remarks: tuple[str, ...]
    runs: tuple[str, ...]
    """Imported runs, each of which is simulated by what the other ones determine."""
    columns: str = ""
    """columns.toml, where a person has to write it."""
    given: str = ""
    """Options of every fit."""
    more: tuple[str, ...] = ()
    """Imports of further `runs`, which nobody needs to type."""
    implied: Mapping[str, float] = field(default_factory=dict)
    """Parameters that the authors' model leaves out, in addition to those published."""


def column_map(names: Mapping[str, str]) -> str:
    """columns.toml: run's column -> lines of its entry."""
    return "\n".join(f"[columns.{column}]\n{lines}" for column, lines in names.items()) + "\n"


def fits(runs: str, more: str = "") -> str:
    return f"legid fit {runs} --rig rig.toml {more}--json fit.json --model-out model.json"


MACHINES = (
    Machine(
        "Geared pendulum", "dfki-ric-underactuated-lab/torque_limited_simple_pendulum",
        "ed17ea2d32a35ad944944ca03ef57693e2986732", "BSD-3-Clause",
        {"ddp.csv": "results/control_method_ddp/data_measured.csv",
         "collocation.csv": "results/control_method_direct_collocation/data_measured.csv",
         "identification.csv": "results/control_method_pd/system_identification/data_measured.csv"},
        JOINT,
        ("legid import ddp.csv collocation.csv identification.csv --out runs --yes",
         "legid fit runs/identification.csv --rig rig.toml",
         fits("runs/ddp.csv"),
         "legid validate model.json runs/collocation.csv --rig rig.toml",
         "legid diagnose runs/ddp.csv runs/collocation.csv --rig rig.toml"),
        {"beta1": 0.150, "beta2": 0.304}, "masses and lengths of hardware/testbench_description.md, rotor included",
        ("The authors identified 0.063 kg m² and 0.102 kg m from `identification.csv`, which legid does not trust.",
         "Both parameters are 1.2 times those of the drawing: a wrong torque scale does that, unseen."),
        ("runs/ddp.csv", "runs/collocation.csv")),
    Machine(
        "Brachiating robot of two links, AcroMonk", "dfki-ric-underactuated-lab/acromonk",
        "ea0b53d2ac50cf6ac2939ffa207c0790be5f3baa", "BSD-3-Clause",
        {f"{name}.csv": f"results/real_system/csvs/{name}.csv" for name in (
            "ZF_pd_1x", "ZB_pd_1x", "BF_tvlqr_1x", "ZF_tvlqr_1x")},
        '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[sampling]\nrate_hz = 50.0\n',
        ("legid import ZF_pd_1x.csv ZB_pd_1x.csv BF_tvlqr_1x.csv ZF_tvlqr_1x.csv --out runs --yes",
         "legid import ZF_pd_1x.csv ZB_pd_1x.csv BF_tvlqr_1x.csv ZF_tvlqr_1x.csv --out runs --map runs/columns.toml",
         fits("runs/ZF_pd_1x.csv runs/ZB_pd_1x.csv runs/BF_tvlqr_1x.csv", "--fix beta4=0.431 "),
         "legid validate model.json runs/ZF_tvlqr_1x.csv --rig rig.toml",
         "legid diagnose runs/ZF_pd_1x.csv runs/ZB_pd_1x.csv runs/BF_tvlqr_1x.csv --rig rig.toml --fix beta4=0.431"),
        {"beta1": 0.1175, "beta2": 0.0132, "beta3": 0.0232, "beta5": 0.0738},
        "CAD values of data/simulation_models/acromonk.urdf, hooks included",
        ("Without a known value the fit writes no model and asks for one: beta4, or the length l1.",),
        ("runs/ZF_pd_1x.csv", "runs/ZB_pd_1x.csv", "runs/BF_tvlqr_1x.csv", "runs/ZF_tvlqr_1x.csv"),
        given="--fix beta4=0.431 "),
    Machine(
        "Brachiating robot of three bodies, RicMonk", "dfki-ric-underactuated-lab/ricmonk",
        "05b19cf011708f179049383e8507a8645fe1848c", "BSD-3-Clause",
        {f"{name}.csv": f"results/singleBrachiation_tvlqr/TVLQR_{name}/measured.csv"
         for name in ("ZF", "ZB", "BF", "FB")},
        '[mechanism]\nmodel = "chain"\nlinks = 3\nactuated = [2, 3]\n[sampling]\nrate_hz = 50.0\n'
        "[prior]\nl1 = [0.314, 0.001]      # by the CAD file\nl2 = [0.0, 0.0005]       # two joints on one axis\n",
        ("legid import ZF.csv ZB.csv BF.csv FB.csv --out runs --yes",
         "legid import ZF.csv ZB.csv BF.csv FB.csv --out runs --map runs/columns.toml",
         fits("runs/ZF.csv runs/ZB.csv runs/BF.csv"),
         "legid validate model.json runs/FB.csv --rig rig.toml",
         "legid diagnose runs/ZF.csv runs/ZB.csv runs/BF.csv runs/FB.csv --rig rig.toml"),
        {"beta1": 0.300, "beta2": 0.0928, "beta3": 0.0231, "beta4": 0.151, "beta5": 0.0228, "beta7": 0.977,
         "beta8": 0.480, "beta9": 0.0726},
        "CAD values of data/simulation_models/finalRicMonkCurrent.urdf, hooks included",
        ("CAD has no rotor: the tail's own inertia is 1.8 times its value.",),
        ("runs/ZF.csv", "runs/ZB.csv", "runs/BF.csv", "runs/FB.csv")),
    Machine(
        "Joint 2 of a UR10e", "shamilmamedov/dynamic_calibration",
        "11af40e7deb758ec080a175fed8fcdd6c99aca29", "none stated",
        {"joint_2.csv": "dataset_ur10e/jointwise_motion/ur-20_01_22-joint_2.csv"},
        JOINT,
        ("legid import joint_2.csv --out runs",
         "legid import joint_2.csv --map columns.toml --out runs",
         fits("runs/joint_2.csv"),
         "legid diagnose runs/joint_2.csv --rig rig.toml"),
        {"beta1": 18.2, "beta2": 11.4, "beta3": 20.2, "beta4": 13.3},
        "drive gain, bodies, rotor and friction identified by the authors, UR10E_parameters.txt, arm straight",
        ("By the URDF's masses the first moment is 12.6 kg m. The authors' gain is too small, which no motion shows.",),
        ("first/joint_2.csv", "second/joint_2.csv"),
        column_map({"time_s": 'name = "column 1"', "q1_rad": 'name = "column 3"\noffset = -1.5707963   # 0 is hanging',
                    "tau1_nm": 'name = "column 15"\nunit = "A"\nscale = 10.6956         # N m per A'}),
        more=("legid import joint_2.csv --map columns.toml --out first --span 1194,1227",
              "legid import joint_2.csv --map columns.toml --out second --span 1227,1260")),
    Machine(
        "Pendulum of a textbook's rotary servo", "Prof-Carter/book_ip",
        "7d5e476f404a7c83ac251f112998b723c586a05e", "none stated",
        {"adip_pend_data.mat": "mfiles/p1c3/adip_pend_data.mat"},
        '[mechanism]\nmodel = "joint1"\nactuated = []     # it swings freely\n',
        ("legid import adip_pend_data.mat --out runs --yes --span 50,66",
         fits("runs/adip_pend_data.csv", "--fix beta2=0.01872 "),
         "legid diagnose runs/adip_pend_data.csv --rig rig.toml --fix beta2=0.01872"),
        {"beta1": 0.004556, "beta3": 0.000101}, "J2 + m2 l2², mu2 in ip_toolbox_1.0.2/iptools/adip_para.m",
        ("The book fits seconds 50 to 66 as well. Its m2 l2 = 0.096 kg × 0.195 m is given: a free swing shows ratios "
         "only.",),
        ("first/adip_pend_data.csv", "second/adip_pend_data.csv"),
        given="--fix beta2=0.01872 ",
        more=("legid import adip_pend_data.mat --map runs/columns.toml --out first --span 50,58",
              "legid import adip_pend_data.mat --map runs/columns.toml --out second --span 58,66")),
    Machine(
        "Joints 2 and 4 of a WAM arm, through cables and gears", "amir-noohian/dynamics-estimation",
        "855e9e5c0811f3a3716612741bc33c02574aabea", "none stated",
        {"state_4.json": "pest_2dof_nogravity/wam_data/state_4.json"},
        '[mechanism]\nmodel = "leg2"\nactuated = [1, 2]\n',
        ("legid import state_4.json --map columns.toml --out first --span 1749429321,1749429326.87",
         "legid import state_4.json --map columns.toml --out second --span 1749429326.87,1749429332",
         fits("first/state_4.csv"),
         "legid validate model.json second/state_4.csv --rig rig.toml",
         "legid diagnose first/state_4.csv second/state_4.csv --rig rig.toml"),
        {"beta1": 1.473, "beta2": 0.360, "beta3": 0.568, "beta6": 1.234, "beta7": 0.687, "beta8": 2.417,
         "beta9": 0.269},
        "identified by the authors, processed_data/pi_estimated_nograv_4.mat, without gravity; its sign turned",
        ("The authors' script takes the rows of torque for those of gravity, so all signs are reversed.",
         "Inertias and Coulomb friction of joint 2 agree. The arm is upright, so a free run falls over."),
        ("first/state_4.csv", "second/state_4.csv"),
        column_map({"time_s": 'name = "time"', "q1_rad": 'name = "position[2]"\noffset = 3.14159265   # 0 is upright',
                    "q2_rad": 'name = "position[4]"', "tau1_nm": 'name = "effort[2]"',
                    "tau2_nm": 'name = "effort[4]"'})),
    Machine(
        "Joint 5 of an arm, AM-D02, a geared motor", "YIZHIXIAOCANGSHU/Friction-Identification-for-Manipulators",
        "f915751262ab6c43dc436b7395f41b03f2e8ee2b", "none stated",
        {"joint_5.npz": "results/real_friction_identification_joint_5.npz"},
        JOINT,
        ("legid import joint_5.npz --map columns.toml --out first --span 0,16",
         "legid import joint_5.npz --map columns.toml --out second --span 16,32",
         fits("first/joint_5.csv", "--fix beta1=0.00035 --fix beta2=0 "),
         "legid validate model.json second/joint_5.csv --rig rig.toml",
         "legid diagnose first/joint_5.csv second/joint_5.csv --rig rig.toml --fix beta1=0.00035 --fix beta2=0"),
        {"beta3": 0.0397, "beta4": 0.1163},
        "identified by the authors, results/real_friction_identification_joint_5.json",
        ("Unfixed, the fit writes no model: the record does not determine beta1.",
         "The URDF's inertia, given here, has no rotor. Friction then is not known, and free runs fail."),
        ("first/joint_5.csv", "second/joint_5.csv"),
        column_map({"time_s": 'name = "time"', "q1_rad": 'name = "q[5]"', "tau1_nm": 'name = "tau_measured[5]"'}),
        given="--fix beta1=0.00035 --fix beta2=0 "),
    Machine(
        "Geared hobby servo with a weight, falling with its motor off", "mauicv/servo-sysid",
        "e4a48407899108cae084ff25e8b5d12e3da070cc", "none stated",
        {f"drop-response-{n}.json": f"src/sysid/dataset/drop-response-{n}.json#data" for n in (1, 2, 3, 4)},
        '[mechanism]\nmodel = "joint1"\nactuated = []     # its motor is off\ngravity_mps2 = 9.8\n'
        "[sampling]\nrate_hz = 50.0\n",
        ("legid import drop-response-1.json --map columns.toml --out runs --rate 50 --span 2.1,5",
         "legid import drop-response-2.json --map columns.toml --out runs --rate 50 --span 0.92,4",
         fits("runs/drop-response-1.csv", "--fix beta2=0.0596 "),
         "legid validate model.json runs/drop-response-2.csv --rig rig.toml",
         "legid diagnose runs/drop-response-1.csv runs/drop-response-2.csv --rig rig.toml --fix beta2=0.0596"),
        {"beta1": 0.01553, "beta4": 0.1}, "the authors' MuJoCo model, src/sysid/desc/robot.xml, without damping",
        ("The published inertia has a nominal rotor of 0.005 kg m². A rotor behind gears can explain the ratio.",
         "The first element of `data` in each file was saved as a file of its own.",
         "One drop determines all values, but three drops together do not: most fits of the last table fail."),
        tuple(f"runs/drop-response-{n}.csv" for n in (1, 2, 3, 4)),
        column_map({"q1_rad": 'name = "sensor_data"\nscale = 3.14159265      # half turns\n'
                              "offset = 1.57079633     # 0 is horizontal"}),
        given="--fix beta2=0.0596 ",
        more=("legid import drop-response-3.json --map columns.toml --out runs --rate 50 --span 1.62,5",
              "legid import drop-response-4.json --map columns.toml --out runs --rate 50 --span 2.56,6"),
        implied={"beta3": 0.0}),
    Machine(
        "Leg of a compass-gait robot, direct drive", "imanchester/SydneyCompassGait",
        "92546f615946c6bb43e1ebb6e23d4bf7856199aa", "MIT",
        {"inner.mat": "System Identification/SysID_Experiment 1/realVSmodel_fwAnd5vstepsx3AndChirp_innerSW.mat"},
        JOINT,
        ("legid import inner.mat --map columns.toml --out first --span 0,39",
         "legid import inner.mat --map columns.toml --out second --span 39,78",
         fits("first/inner.csv"),
         "legid validate model.json second/inner.csv --rig rig.toml",
         "legid diagnose first/inner.csv second/inner.csv --rig rig.toml"),
        {"beta1": 0.004322, "beta2": 0.0313, "beta3": 0.001403, "beta4": 0.005452},
        "identified by the authors from the whole record: J, mglg, Kv, Kc in the same file",
        ("Their values minimise the error of this record's simulation, both halves included.",),
        ("first/inner.csv", "second/inner.csv"),
        column_map({"time_s": 'name = "datatimeall"', "q1_rad": 'name = "dataoutall"\nunit = "deg"',
                    "tau1_nm": 'name = "datainall"\nunit = "A"\nscale = 0.0183          # N m per A'})),
    Machine(
        "Cart of a cart-pendulum, on a belt", "nielsSkov/masterThesisMatlab",
        "0e2c7253fe6e740c36da872508a71c0d1f66a965", "none stated",
        {f"{name}.csv": f"parameterEstimation/data/cartTest1/testOffPoint{name}.csv"
         for name in ("Four", "Five", "Six")},
        JOINT + "gravity_mps2 = 0.0\n",
        ("legid import Four.csv Five.csv Six.csv --map columns.toml --out runs",
         fits("runs/Four.csv runs/Five.csv"),
         "legid validate model.json runs/Six.csv --rig rig.toml",
         "legid diagnose runs/Four.csv runs/Five.csv runs/Six.csv --rig rig.toml"),
        {"beta1": 6.28, "beta3": 3.92},
        "mass; mean of friction over the rail, estFrictionsAndErrn_new_atEnd.mat, without viscous friction",
        ("Friction depends on the place: published values go from 2.7 to 6.6 N. legid has one value.",),
        ("runs/Four.csv", "runs/Five.csv", "runs/Six.csv"),
        column_map({"time_s": 'name = "column 1"', "q1_m": 'name = "column 3"',
                    "tau1_n": 'name = "column 2"\nunit = "A"\nscale = 3.336           # N per A'}),
        implied={"beta2": 0.0}),
)
