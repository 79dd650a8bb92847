"""Domains, children and clients for tests of whole processes."""

import os

import pytest


@pytest.fixture(scope="module")
def bag_domain():
    """A ROS domain: the one of the environment, else one of this process."""
    pytest.importorskip("rclpy")
    return int(os.environ.get("ROS_DOMAIN_ID") or 1 + os.getpid() % 100)


@pytest.fixture
def children(bag_domain, tmp_path):
    from bag_nodes import Children

    started = Children(bag_domain, tmp_path)
    yield started
    started.end_all()


@pytest.fixture
def client(bag_domain):
    from bag_nodes import Client

    node = Client(bag_domain)
    yield node
    node.close()
