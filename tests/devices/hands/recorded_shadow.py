"""Messages that the maker has published: "Shadow Dexterous Hand", user guide, *Command Line Interface*.

shadow-robot/sr_dexterous_hand_documentation at b5e94919, docs/user_guide/sd_command_line.rst. The guide prints them
without their headers' times but for the controllers'; they stand here in the JSON in which rosbridge sends them.
"""

from __future__ import annotations

import json

NAMES = [
    "rh_FFJ1", "rh_FFJ2", "rh_FFJ3", "rh_FFJ4", "rh_LFJ1", "rh_LFJ2", "rh_LFJ3", "rh_LFJ4",
    "rh_LFJ5", "rh_MFJ1", "rh_MFJ2", "rh_MFJ3", "rh_MFJ4", "rh_RFJ1", "rh_RFJ2", "rh_RFJ3",
    "rh_RFJ4", "rh_THJ1", "rh_THJ2", "rh_THJ3", "rh_THJ4", "rh_THJ5", "rh_WRJ1", "rh_WRJ2",
]  # fmt: skip
POSITIONS = [
    1.279751244673038, 1.7231505348398373, 1.2957917583498741, -0.00406710173435502,
    0.054689233814909366, 1.253488840949725, 1.5395435039130654, 0.02170017906073821,
    0.1489674305718295, 1.08814400717011, 1.638917596069165, 1.4315445985097324,
    0.00989364236002074, 1.2257618075487349, 1.8331224739256338, 1.2888368284819698,
    -0.13269012433948385, 0.14435534682895756, 0.6980816915624072, 0.18782898954368935,
    1.124295322901818, 0.21905854304869088, -0.048455186771971595, -0.0032803323337213066,
]  # fmt: skip
VELOCITIES = [
    -7.484333985952662e-06, -7.484333985952662e-06, 0.0023735860019749185, 0.00062181267775619,
    -0.0005871136552505063, -0.0005871136552505063, 0.0020967687295392933, 0.0001739028157522596,
    0.0004985252400775274, -9.485516545601461e-06, -9.485516545601461e-06, -0.0007068752456452666,
    -0.0012475428276090576, 0.0008426052935621657, 0.0008426052935621657, 0.001237001167977189,
    -0.0026444893567459573, 0.0025260047430310925, -0.0003217106977882921, 6.159570145597239e-05,
    -0.0023454723015513593, 0.0009436399232442155, 0.00017469681801687975, -4.900148416020751e-05,
]  # fmt: skip
EFFORTS = [
    -1.3660655058510802, -1.3660655058510802, -2.030169817308198, -1.9577332816789155,
    0.0, 0.0, -17.29928766980003, -1.5006516553524243,
    -1.8579749510438912, -1.504877130092884, -1.504877130092884, -0.3374653182042338,
    -1.6492254479379729, -8.476660697182016, -8.476660697182016, -3.3867013328219056,
    -2.3404145772688683, -0.7688013735971971, 11.02319645071454, 0.8482082620071664,
    0.08818910881575533, 1.127772119947565, -2.2344970991165316, -3.5544023107705667,
]  # fmt: skip
"""/joint_states."""
CONTROLLED = [
    "rh_FFJ1", "rh_FFJ2", "rh_FFJ3", "rh_FFJ4", "rh_LFJ1", "rh_LFJ2", "rh_LFJ3", "rh_LFJ4",
    "rh_LFJ5", "rh_MFJ1", "rh_MFJ2", "rh_MFJ3", "rh_MFJ4", "rh_RFJ1", "rh_RFJ2", "rh_RFJ3",
    "rh_RFJ4", "rh_THJ1", "rh_THJ2", "rh_THJ3", "rh_THJ4", "rh_THJ5",
]  # fmt: skip
DESIRED = [
    0.00011967184218224583, 0.0005548183242297389, 0.00041894754950187046, -0.10062701434085283,
    8.783502460599571e-05, 0.0004641775977824551, 0.0006856740495884452, 0.1096183605452164,
    0.004913053249636874, 0.00010239955504565482, 0.00047931794332974065, 0.00013111648840283263,
    -0.10127973823850217, 8.996037101196772e-05, 0.0004488761418596776, 0.0001876294034980873,
    0.1001350676276958, -0.035240921470978015, -0.31784852833458305, 0.0007460299926848393,
    0.04911052560971607, -0.0002772503508325329,
]  # fmt: skip
"""/rh_trajectory_controller/state."""
COMMANDED = [
    "rh_FFJ1", "rh_FFJ2", "rh_FFJ3", "rh_FFJ4", "rh_MFJ1", "rh_MFJ2", "rh_MFJ3", "rh_MFJ4",
    "rh_RFJ1", "rh_RFJ2", "rh_RFJ3", "rh_RFJ4", "rh_LFJ1", "rh_LFJ2", "rh_LFJ3", "rh_LFJ4",
    "rh_LFJ5", "rh_THJ1", "rh_THJ2", "rh_THJ3", "rh_THJ4", "rh_THJ5",
]  # fmt: skip
"""Joints of the example of /rh_trajectory_controller/command, in its order."""
"""/rh_wr_trajectory_controller/state."""


def publication(topic: str, message: dict[str, object], secs: int = 583, nsecs: int = 274000000) -> bytes:
    """What rosbridge sends of a message that has a header."""
    header = {"seq": 29135, "stamp": {"secs": secs, "nsecs": nsecs}, "frame_id": ""}
    return json.dumps({"op": "publish", "topic": topic, "msg": {"header": header} | message}).encode()


def joint_states(secs: int = 583, nsecs: int = 274000000, **changed: object) -> bytes:
    """The example of /joint_states."""
    fields: dict[str, object] = {
        "name": NAMES, "position": POSITIONS, "velocity": VELOCITIES, "effort": EFFORTS,
    }  # fmt: skip
    return publication("/joint_states", fields | changed, secs, nsecs)


def controller_state(**changed: object) -> bytes:
    """The example of /rh_trajectory_controller/state."""
    desired = {"positions": DESIRED, "velocities": [0.0] * len(DESIRED), "accelerations": [0.0] * len(DESIRED),
               "effort": [], "time_from_start": {"secs": 0, "nsecs": 0}}  # fmt: skip
    fields: dict[str, object] = {"joint_names": CONTROLLED, "desired": desired}
    return publication("/rh_trajectory_controller/state", fields | changed)


def diagnostics(flags: str = " None", level: int = 0, temperature: str = "34.562500") -> bytes:
    """A motor's status as `add_diagnostics` of sr_motor_robot_lib.cpp (sr-ros-interface-ethercat) writes it."""
    values = {"Motor ID": "3", "Strain Gauge Left": "12", "Motor Flags": flags, "Measured Current": "0.105000",
              "Measured Voltage": "23.906250", "Measured Effort": "-15.000000", "Temperature": temperature}  # fmt: skip
    status = {"level": level, "name": "rh SRDMotor FFJ0", "message": flags if level else "OK", "hardware_id": "",
              "values": [{"key": key, "value": value} for key, value in values.items()]}  # fmt: skip
    other = {"level": 2, "name": "ra: controller", "message": "stopped", "hardware_id": "", "values": []}
    return publication("/diagnostics", {"status": [other, status]})
