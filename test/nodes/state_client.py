"""The calls behind ``ros2 lifecycle`` and ``ros2 param``, for nodes of /cell."""

import yaml
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from live_cell import DEADLINE_S
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python

from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.nodes.runtime.running import PeerNode


class StateClient:
    """Asks nodes for their state, and for others; a context that leaves the graph."""

    def __init__(self):
        self.peer = PeerNode("state_client", "/cell")
        self._clients = {}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.peer.close()

    def call(self, kind, name, **fields):
        """Return the answer of service ``name``."""
        client = self._clients.get(name)
        if client is None:
            client = self._clients[name] = self.peer.node.create_client(kind, name)
        assert self.peer.work_until(client.service_is_ready, load_scaled_timeout(DEADLINE_S)), (
            f"no {name}"
        )
        request = kind.Request()
        for field, value in fields.items():
            setattr(request, field, value)
        future = client.call_async(request)
        assert self.peer.work_until(future.done, load_scaled_timeout(DEADLINE_S)), (
            f"no answer of {name}"
        )
        return future.result()

    def state(self, node):
        return self.call(GetState, f"{node}/get_state").current_state.label

    def transitions(self, node):
        found = self.call(GetAvailableTransitions, f"{node}/get_available_transitions")
        return {t.transition.label for t in found.available_transitions}

    def change(self, node, *labels):
        """Go through transitions one by one; return whether each of them succeeded."""
        return [self._change(node, label) for label in labels]

    def set(self, node, name, value):
        """Return whether a parameter was set, and the reason."""
        message = Parameter(name, value=value).to_parameter_msg()
        answer = self.call(SetParameters, f"{node}/set_parameters", parameters=[message])
        return answer.results[0].successful, answer.results[0].reason

    def dump(self, node, path):
        """Write a parameter file as ``ros2 param dump`` does: every listed parameter, at once."""
        listed = self.call(ListParameters, f"{node}/list_parameters").result.names
        found = self.call(GetParameters, f"{node}/get_parameters", names=sorted(listed)).values
        assert len(found) == len(listed)
        parameters = {}
        for name, value in zip(sorted(listed), found, strict=True):
            *groups, last = name.split(".")
            place = parameters
            for group in groups:
                place = place.setdefault(group, {})
            plain = parameter_value_to_python(value)
            assert plain is not None, name
            place[last] = plain if isinstance(plain, (bool, int, float, str)) else list(plain)
        path.write_text(yaml.dump({f"/cell/{node}": {"ros__parameters": parameters}}))

    def _change(self, node, label):
        request = ChangeState.Request()
        request.transition.label = label
        name = f"{node}/change_state"
        return self.call(ChangeState, name, transition=request.transition).success
