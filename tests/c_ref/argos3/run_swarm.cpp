/* A small simulator around the stand-ins of argos_stub.h: it runs a swarm that standard input describes, in
 * lines of words:
 *
 *     loop LABEL NAME=VALUE ...                        loop functions and their attributes
 *     robots LABEL COUNT FIRST_NUMBER NAME=VALUE ...   robots kivN with a controller and its parameters
 *     run TICKS PACKET_SIZE RANGE [reset]              with reset, the experiment is run a second time
 *     floor SEED SIDE TILE                             prints the floor of a seed instead: 1 for a black tile
 *
 * Robots stand on a line, half a range apart, and each tick at a new place of it. In each tick they receive
 * the packets of the last tick from within the range. Exit code 1 with a message for a CARGoSException. */
#include "argos_stub.h"

#include <algorithm>

using namespace argos;

namespace
{
struct Robot {
    CCI_DifferentialSteeringActuator wheels;
    CCI_RangeAndBearingActuator transmitter;
    CCI_RangeAndBearingSensor receiver;
    CCI_KheperaIVGroundSensor ground_sensor;
    CCI_KheperaIVProximitySensor proximity_sensor;
    CControllableEntity *entity = nullptr;
    CVector2 position;
};

using Robots = std::vector<std::unique_ptr<Robot>>;

TConfigurationNode ReadAttributes(std::istream &line)
{
    TConfigurationNode attributes;
    std::string attribute;
    while (line >> attribute) {
        const size_t equals = attribute.find('=');
        attributes[attribute.substr(0, equals)] = attribute.substr(equals + 1);
    }
    return attributes;
}

void AddRobots(Robots &robots, std::istream &line)
{
    std::string label;
    int count = 0;
    int first_number = 0;
    line >> label >> count >> first_number;
    TConfigurationNode parameters = ReadAttributes(line);
    for (int number = first_number; number < first_number + count; ++number) {
        auto robot = std::make_unique<Robot>();
        auto controller = std::unique_ptr<CCI_Controller>(Makers<CCI_Controller>().at(label)());
        controller->id = "kiv" + std::to_string(number);
        controller->devices = {
            {"differential_steering actuator", &robot->wheels},
            {"range_and_bearing actuator", &robot->transmitter},
            {"range_and_bearing sensor", &robot->receiver},
            {"kheperaiv_ground sensor", &robot->ground_sensor},
            {"kheperaiv_proximity sensor", &robot->proximity_sensor},
        };
        controller->Init(parameters);
        const std::string id = controller->id;
        robot->entity = new CControllableEntity{std::move(controller)};
        CSimulator::GetInstance().GetSpace().entities["controller"][id].content = robot->entity;
        robots.push_back(std::move(robot));
    }
}

/* Put the robots on a line in another order, and let them sense what is there. */
void Sense(Robots &robots, CLoopFunctions &loop_functions, Real range, std::mt19937_64 &generator)
{
    std::vector<size_t> places(robots.size());
    for (size_t index = 0; index < places.size(); ++index) {
        places[index] = index;
    }
    std::shuffle(places.begin(), places.end(), generator);
    for (size_t index = 0; index < robots.size(); ++index) {
        const Real x = 0.501 * range * static_cast<Real>(places[index]);
        robots[index]->position = CVector2(x, static_cast<Real>(generator() % 1000) / 100.0);
    }
    for (const auto &robot : robots) {
        const CColor colour = loop_functions.GetFloorColor(robot->position);
        const SGroundReading other_tile = {1.0, CVector2()};
        robot->ground_sensor.readings.assign(4, other_tile);
        robot->ground_sensor.readings[3].Value = colour.gray / 255.0;
        robot->proximity_sensor.readings = {{0.2, CRadians(static_cast<Real>(generator() % 6) - 3.0)}};
        robot->receiver.readings.clear();
        for (const auto &sender : robots) {
            const Real distance = std::abs(sender->position.GetX() - robot->position.GetX());
            if (sender != robot && distance < range) {
                robot->receiver.readings.push_back(
                    {distance, CRadians(), CRadians(), sender->transmitter.data});
            }
        }
    }
}

void Run(Robots &robots, CLoopFunctions &loop_functions, UInt32 ticks, Real range)
{
    std::mt19937_64 generator(1);
    CSpace &space = CSimulator::GetInstance().GetSpace();
    CSimulator::GetInstance().max_clock = ticks;
    for (space.clock = 1; space.clock <= ticks; ++space.clock) {
        /* All receive what was sent in the last tick before any robot sends anew. */
        Sense(robots, loop_functions, range, generator);
        for (const auto &robot : robots) {
            robot->entity->GetController().ControlStep();
        }
        loop_functions.PostStep();
    }
    loop_functions.PostExperiment();
}

void PrintFloor(CLoopFunctions &loop_functions, std::istream &line)
{
    int side = 0;
    Real tile = 0.0;
    line >> CSimulator::GetInstance().random_seed >> side >> tile;
    for (int row = 0; row < side; ++row) {
        for (int column = 0; column < side; ++column) {
            const CVector2 centre((column + 0.5) * tile, (row + 0.5) * tile);
            std::cout << (loop_functions.GetFloorColor(centre).gray == 0 ? '1' : '0');
        }
        std::cout << '\n';
    }
}

void RunDescribedSwarm()
{
    Robots robots;
    std::string text;
    std::string loop_label;
    TConfigurationNode loop_attributes;
    while (std::getline(std::cin, text)) {
        std::istringstream line(text);
        std::string word;
        line >> word;
        if (word == "loop") {
            line >> loop_label;
            loop_attributes = ReadAttributes(line);
        } else if (word == "robots") {
            AddRobots(robots, line);
        } else if (word == "floor") {
            const auto loop_functions =
                std::unique_ptr<CLoopFunctions>(Makers<CLoopFunctions>().at(loop_label)());
            loop_functions->Init(loop_attributes);
            PrintFloor(*loop_functions, line);
        } else if (word == "run") {
            UInt32 ticks = 0;
            size_t packet_size = 0;
            Real range = 0.0;
            std::string reset;
            line >> ticks >> packet_size >> range >> reset;
            const auto loop_functions =
                std::unique_ptr<CLoopFunctions>(Makers<CLoopFunctions>().at(loop_label)());
            loop_functions->Init(loop_attributes);
            for (int repetition = 0; repetition < (reset.empty() ? 1 : 2); ++repetition) {
                for (const auto &robot : robots) {
                    robot->transmitter.data = CByteArray(packet_size);
                    if (repetition > 0) {
                        robot->entity->GetController().Reset();
                    }
                }
                if (repetition > 0) {
                    loop_functions->Reset();
                }
                Run(robots, *loop_functions, ticks, range);
            }
            loop_functions->Destroy();
            for (const auto &robot : robots) {
                robot->entity->GetController().Destroy();
            }
        }
    }
}
} // namespace

int main()
{
    try {
        RunDescribedSwarm();
    } catch (const CARGoSException &error) {
        std::cerr << error.what() << std::endl;
        return 1;
    }
    return 0;
}
