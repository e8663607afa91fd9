"""What is wrong between the Unified Namespace and the rest of a `fleet.yaml`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ua_fleet.config.broker_checks import check_broker
from ua_fleet.config.namespace_schema import UnifiedNamespaceConfig
from ua_fleet.config.parts import Parts
from ua_fleet.config.pubsub_schema import PubSubConfig
from ua_fleet.config.schema import DataSetConfig, value_name
from ua_fleet.document import KeyPath
from ua_fleet.uns.topics import NamespaceTopics

__all__ = ["check_namespace"]

_PATH: KeyPath = ("unified_namespace",)


def check_namespace(parts: Parts, config: UnifiedNamespaceConfig, fleet: str) -> None:
    """Note what does not go with it."""
    check_broker(parts.document, _PATH, config.url, config.broker)
    topics = NamespaceTopics(config.topic, config.site, fleet)
    for _, pubsub in parts.connections:
        if pubsub.is_brokered and pubsub.url == config.url:
            _check_topics(parts, topics, pubsub)


def _check_topics(parts: Parts, topics: NamespaceTopics, pubsub: PubSubConfig) -> None:
    """On the broker of PubSub no value may stand where PubSub would take it for a message of its own."""
    tree = pubsub.broker.tree(is_json=pubsub.is_json)
    for topic in (topics.server, *_topics(topics, parts.data)):
        if tree.read(topic) is not None or topic.startswith(f"{pubsub.broker.prefix}/"):
            parts.document.problem(
                (*_PATH, "topic"),
                f"{topic} is a topic of PubSub on the same broker",
                "begin with another level, or use another broker",
            )
            return


def _topics(topics: NamespaceTopics, data: Mapping[tuple[str, str], DataSetConfig]) -> Iterable[str]:
    for (robot, name), data_set in data.items():
        for field in data_set.all_fields():
            yield topics.topic(robot, value_name(name, field))
