# Texte der Seiten, die eine Zelle einrichten. Zahlen kommen mit ihrer Einheit von der Seite.

## Um jede Seite
skip = Zum Inhalt
nav = Seiten
nav-run = Betrieb
nav-setup = Einrichten
nav-system = System
nav-manual = Handbuch
language = Sprache
log-out = Abmelden
steps = Der Weg zum gegriffenen Teil
step-of = Schritt { $number } von { $count }:
understood = Verstanden
back = Zurück
left = Links
right = Rechts
state-starting = STARTET
state-ready = BEREIT
state-busy = MISST
state-fault = FEHLER
state-setup-by = EINRICHTEN durch { $name }
state-setup-nobody = EINRICHTEN
plc-locked = AUTO_LOCK: die Anlage läuft mit dieser Zelle
plc-owner = SPS
plc-nobody = keine SPS verbunden
connection-lost = Keine Verbindung zur Zelle: neuer Versuch läuft

## Schritte
step-welcome = Willkommen
step-cameras = Kameras
step-light = Licht und Schärfe
step-calibrate = Kalibrieren
step-check = Prüfen
step-teach = Einlernen
step-try = Probieren
step-robot = Roboter
step-plc = SPS und Start
state-tick = erledigt
state-doubt = nochmals ansehen
state-gap = fehlt
state-none = hier nicht bekannt

## Wer die Zelle hat
lease = Wer die Zelle hat
lease-free = Die Zelle misst für die Anlage. Um ihre Kameras zu benutzen, übernehmen Sie sie: dann antwortet sie keiner SPS, bis Sie sie zurückgeben.
lease-incomplete = Die Zelle kann noch nicht messen. Übernehmen Sie sie, um sie einzurichten.
lease-locked = Die Anlage läuft mit dieser Zelle (AUTO_LOCK ist 1), deshalb kann niemand sie übernehmen. Schalten Sie die Anlage zuerst auf Handbetrieb.
lease-yours = Sie haben die Zelle. Sie misst nichts für die Anlage, bis Sie sie zurückgeben.
lease-elsewhere = Sie haben die Zelle, an einem anderen Bildschirm. Machen Sie hier weiter, dann sieht jener nur zu.
lease-others = { $name } hat die Zelle. Sie sehen dieselben Bilder und Zahlen, live.
lease-others-view = { $name } hat die Zelle. Sie sehen dieselben Bilder und Zahlen, live; zum Ändern braucht es die Rolle „engineer“.
lease-view = Sie dürfen alles ansehen. Zum Ändern braucht es die Rolle „engineer“.
lease-unattended = Niemand kümmert sich um die Zelle. Sie misst nicht, bis jemand nachgesehen hat, dass niemand darin steht.
lease-take = Zelle übernehmen
lease-take-over = Übernehmen
lease-continue = Hier weitermachen
lease-leave = Zurückgeben
lease-end = Einrichten beenden
idle = { $name }, seit zehn Minuten gab es kein Zeichen von Ihnen, deshalb dürfen Sie nur ansehen. Ihr Passwort bringt Ihre Rechte zurück.
idle-wake = Ich bin da
password = Passwort
ask-take-title = Zelle übernehmen?
ask-take = Die Zelle beendet den laufenden Zyklus, dann fällt READY: jeder Befehl der SPS wird abgelehnt, bis Sie sie zurückgeben.
ask-take-yes = Übernehmen
ask-over-title = Von { $name } übernehmen?
ask-over = { $name } erfährt es und kann danach nur noch zusehen. Es wird im Protokoll vermerkt.
ask-over-yes = Übernehmen
ask-leave-title = Zelle zurückgeben?
ask-leave = Es gelten wieder die aktiven Einstellungen, ein Probepaar wird aufgenommen, dann ist die Zelle BEREIT. Niemand darf in der Zelle stehen, und keine Tafel darf darin liegen.
ask-leave-yes = Zurückgeben
ask-end-title = Ist niemand in der Zelle?
ask-end = Das darf nur sagen, wer nachgesehen hat: danach wird die Zelle BEREIT, und die Anlage kann anlaufen.
ask-end-yes = Ich habe nachgesehen: niemand ist darin

## Was nicht ging: Ursache und Abhilfe
problem-other = Das ging nicht: { $detail }
problem-unreachable = Die Zelle antwortet nicht. Prüfen Sie Netzwerkkabel und Zellen-PC; die Seite versucht es von selbst wieder.
problem-log-in = Sie sind nicht mehr angemeldet. Melden Sie sich neu an.
problem-origin = Der Browser hat nicht gesagt, dass diese Seite fragt. Öffnen Sie die Seite unter ihrer eigenen Adresse.
problem-setup-refused = Das geht gerade nicht: { $detail }
problem-lease-lost = Sie haben die Zelle nicht mehr: { $detail }
problem-lease = Sie haben die Zelle nicht mehr: { $detail }
problem-role = Ihre Rolle erlaubt das nicht. Jemand mit der Rolle „engineer“ kann es.
problem-idle = Seit zehn Minuten gab es kein Zeichen von Ihnen. Geben Sie Ihr Passwort noch einmal ein.
problem-password = Das ist nicht das Passwort.
problem-wait = Zu viele Versuche. Warten Sie { $wait_s } s.
problem-invalid = Das nimmt die Zelle nicht an: { $detail }
problem-unknown = Das gibt es nicht, oder nicht mehr. Laden Sie die Seite neu.
problem-input = Das nimmt die Zelle nicht an: { $detail }
problem-storage = Die Platte des Zellen-PCs ist voll. Schaffen Sie Platz und versuchen Sie es noch einmal.
problem-gone = Dieses Bild ist nicht mehr da. Nehmen Sie ein neues auf.
problem-status-404 = Diese Zelle bietet das nicht an. Bringen Sie edged auf dem Zellen-PC auf den neuen Stand und laden Sie die Seite neu.
problem-status-500 = Die Zelle hat selbst einen Fehler gemacht: sehen Sie in ihr Protokoll (journalctl -u edged).

## Willkommen
welcome-title = { $cell }: einrichten
welcome-new = Neun Schritte von ausgepackten Kameras zum gegriffenen Teil. Ein Haken kommt von dem, was die Zelle hat, nicht von dem, was geklickt wurde.
welcome-complete = Die Zelle hat alles, was sie zum Messen braucht. Jeder Schritt lässt sich ansehen und wiederholen.
welcome-done = Hier fehlt nichts.
welcome-facts = Was die Zelle hat
welcome-later = Mit Befehlen
welcome-later-why = Diese Schritte gibt es noch nicht im Browser. Das Handbuch nennt die Befehle.
next-cameras = Weiter: die Kameras
next-light = Weiter: Licht und Schärfe
next-calibrate = Weiter: kalibrieren
next-check = Weiter: prüfen
fact-cameras = Kameras
fact-cameras-found =
    { $count ->
        [0] keine gefunden
        [one] eine gefunden
       *[other] { $count } gefunden
    }{ $troubled ->
        [0] { "" }
        [one] , eine mit einem Problem
       *[other] , { $troubled } mit einem Problem
    }
fact-unknown = noch nicht nachgesehen
fact-rig = Kalibrierung
fact-rig-sigma = (±{ $sigma } µm, wo Teile eingelernt wurden)
fact-no-rig = noch keine
fact-jobs = Aufträge
fact-no-jobs = noch keine
fact-plc = SPS
fact-plc-owner = schreibt von
fact-no-plc = noch hat keine geschrieben
fact-error = Fehler
manual-cameras = so richtet man Kameras ein
manual-light = so richtet man Kameras ein
manual-calibrate = so kalibriert man
manual-check = so prüft man
manual-teach = so lernt man ein
manual-try = so läuft der Betrieb
manual-robot = so misst man den Roboter ein
manual-plc = so verbindet man eine SPS

## Live-Bilder
live-left = Linke Kamera, live
live-right = Rechte Kamera, live
live-waiting = Das erste Bild kommt gleich.
live-watching = Ein Bild kommt, sobald auf die Kameras sieht, wer die Zelle hat.
live-take = Kein Bild: übernehmen Sie die Zelle, um ihre Kameras zu sehen.

## Kameras
cameras-title = Kameras
cameras-what = Beide Kameras müssen da sein, ohne Problem, und jede auf ihrer Seite, von den Kameras zum Teil gesehen.
cameras-found = Gefunden
cameras-none = Keine Kamera antwortet. Prüfen Sie Strom und Netzwerkkabel; auch eine Kamera in einem anderen Subnetz wird gezeigt, und was zu ändern ist.
cameras-again = Neu suchen
is-left = linke Kamera
is-right = rechte Kamera
is-neither = von dieser Zelle nicht benutzt
trouble-controlled-by-another-program-or-host = von einem anderen Programm oder PC belegt: beenden Sie jenes
trouble-wrong-subnet = ihre Adresse gehört zu einem anderen Subnetz als die Netzwerkkarte
wave-title = Welche ist die linke?
wave-what = Winken Sie nur vor der linken Kamera. Die Kamera, vor der sich etwas bewegt, wird die linke.
wave-start = Ich winke jetzt
wave-again = Noch einmal
wave-now = Winken Sie jetzt vor der linken Kamera.
wave-nobody = Vor einer Kamera allein war keine Hand zu sehen. Gehen Sie näher an die linke, und weg von der anderen.
wave-right = Das linke Bild hat sich bewegt: die Kameras sind auf ihren Seiten.
wave-swapped = Das andere Bild hat sich bewegt: links und rechts sind jetzt getauscht.
keep-what = Das ist ein Versuch: wenn Sie die Zelle zurückgeben, ist es wie zuvor, außer Sie behalten es.
keep = Behalten
kept = Behalten.
test-title = Probepaar
test-what = Eine Belichtung beider Kameras. Wie weit sie auseinanderliegen, bestimmt, wie schnell sich ein Teil bewegen darf.
test-take = Probepaar aufnehmen
test-left = Probebild der linken Kamera
test-right = Probebild der rechten Kamera
test-skew = { $skew } ms zwischen den beiden Belichtungen.
test-together = Nahe genug für ein Teil, das sich bewegt.
test-apart = Zu weit auseinander für ein Teil, das sich bewegt: prüfen Sie den Trigger.

## Licht und Schärfe
light-title = Licht und Schärfe
light-what = Kanten scharf, nichts übersteuert: zuerst das Licht, dann die Ringe der Objektive, und sehen Sie dabei, was es kostet.
light-no-settings = Hier lässt sich nichts einstellen: die Kamera nennt keine Grenzen oder ist nicht da.
light-no-figures = Zahlen kommen mit den Live-Bildern.
settings-left = Einstellungen der linken Kamera
settings-right = Einstellungen der rechten Kamera
setting-exposure-us = Belichtung
setting-gain-db = Verstärkung
field-limits = Eine Zahl von { $low } bis { $high } { $unit }
field-number = Eine Zahl, als 0,5 oder 0.5
light-head = Licht
light-figures = { $clipped } % übersteuert, { $dark } % zu dunkel, Rauschen { $noise } und Kontrast { $contrast } Grauwerte
advice-good = Die Belichtung ist gut.
advice-less-light = Etwas ist übersteuert: weniger Belichtung oder weniger Licht. Dort lässt sich nichts messen.
advice-more-light = Zu dunkel: länger belichten, oder mehr Licht.
advice-light-for-gain = Verrauscht: weniger Verstärkung, dafür länger belichten oder mehr Licht.
advice-take = { $exposure } µs einstellen
legend-clipped = übersteuert
legend-dark = zu dunkel
light-copy = Rechte Kamera genauso einstellen
focus-title = Schärfe
focus-none = Keine Kanten zu beurteilen: legen Sie eine Tafel oder ein Teil hin.
focus-now = Kanten sind { $now } px breit
focus-best = bestes { $best } px
focus-cost =
    { $isFree ->
        [0] Das kostet nichts an Sigma Z.
       *[other] Das kostet +{ $percent } % an Sigma Z.
    }
focus-reset = Bestes vergessen

## Kalibrieren
calibrate-title = Kalibrieren
calibrate-what = Halten Sie eine Kalibriertafel vor beide Kameras, an verschiedenen Orten und verschieden geneigt. edged sagt, welche Ansicht am meisten hilft, und wann es genug ist.
calibrate-new = Andere Kalibrierung beginnen
calibrate-board = Tafel:
calibrate-looking = Halten Sie die Tafel vor beide Kameras: sie wird erkannt.
board-title = Welche Tafel?
board-recognise = In den Bildern erkennen
board-state = Ich gebe sie an
board-kind = Art
kind-chessboard = Schachbrett
kind-charuco = ChArUco
kind-dots = Punktplatte
kind-circles = versetzte Kreise
board-columns = Innere Ecken (oder Marken) je Zeile
board-rows = Zeilen davon
board-marker = Kante eines Markers
board-dictionary = Wörterbuch der Marker
board-mm = Kante eines Feldes
board-pitch = Von Marke zu Marke
board-goal = Ziel: ein Punkt im Messraum auf ±
board-proof = Messen Sie die Länge mit dem Messschieber über viele Felder. Nichts in den Bildern kann sie beweisen, und jede Koordinate hängt daran.
board-begin = Beginnen
sigma-unknown =
    { $used ->
        [0] Zeigen Sie beiden Kameras die Tafel.
        [one] Eine Ansicht. Die erste Zahl kommt mit dreien.
       *[other] { $used } Ansichten. Die erste Zahl kommt bald.
    }
sigma-now = ein Punkt hier: jetzt ±{ $now } µm
sigma-then = ±{ $then } mit dieser Ansicht
sigma-goal = Ziel ±{ $goal }
sigma-again = rechnet mit der letzten Ansicht …
sigma-reached = erreicht
sigma-on = weiter
sigma-more =
    { $count ->
        [one] noch etwa eine
       *[other] noch etwa { $count }
    }
ghost-here = hier
ghost-share = { $percent } % am gestrichelten Ort
seen-whole = Die ganze Tafel ist zu sehen.
seen-clipped = Teile der Tafel sind übersteuert: weniger Licht.
board-still = Die Tafel ist ruhig.
board-moves = Halten Sie die Tafel einen Augenblick ruhig.
auto-start = Ansichten von selbst aufnehmen
auto-stop = Nicht mehr von selbst
view-take = Diese Ansicht jetzt
sound-on = Ton ist an
sound-off = Ton ist aus
ghost-where = Nächste Ansicht:
at-upper-left = oben links
at-upper-middle = oben in der Mitte
at-upper-right = oben rechts
at-middle-left = links
at-middle-middle = in der Mitte
at-middle-right = rechts
at-lower-left = unten links
at-lower-middle = unten in der Mitte
at-lower-right = unten rechts
far-near = nah
far-middle = in mittlerem Abstand
far-far = fern
far-any = in beliebigem Abstand
tilt-square = gerade vor der linken Kamera
tilt-right-near = rechte Seite zu den Kameras
tilt-left-near = linke Seite zu den Kameras
tilt-lower-away = untere Seite von den Kameras weg
tilt-upper-away = obere Seite von den Kameras weg
missing-dark = Keine Tafel: das Bild ist zu dunkel.
missing-bright = Keine Tafel: das Bild ist zu hell.
missing-not-found = Es ist keine ganze Tafel zu sehen.
waits-no-board = Wartet auf die Tafel.
waits-no-board-left = Die linke Kamera sieht nicht die ganze Tafel.
waits-no-board-right = Die rechte Kamera sieht nicht die ganze Tafel.
waits-moving = Wartet, bis die Tafel ruhig ist.
waits-same = Diese Ansicht gibt es schon: bringen Sie die Tafel an den gestrichelten Ort.
waits-elsewhere = Bringen Sie die Tafel an den gestrichelten Ort.
waits-busy = Einen Augenblick.
waits-board-unknown = Die Tafel ist noch nicht erkannt.
why-left-out = Von Hand weggelassen.
why-not-found = Die Tafel wurde nicht gefunden.
why-excluded = Sie widerspricht den anderen Ansichten.
views-title =
    { $count ->
        [one] Eine Ansicht
       *[other] { $count } Ansichten
    }
view = Ansicht { $name }
view-rms = rms { $rms } px
view-new = wird gemessen
view-heldout = zurückgehalten { $heldout } px
view-remove = Weglassen
view-remove-name = Ansicht { $name } weglassen
view-taken = Ansicht { $name } aufgenommen.
view-refused = Ansicht { $name } ist nicht brauchbar: { $why }
view-removed = Ansicht { $name } ist weggelassen.
undo = Rückgängig
undone = Rückgängig gemacht.
verdict-good = Diese Kalibrierung ist gut.
verdict-usable = Diese Kalibrierung ist brauchbar.
verdict-repeat = Noch nicht gut genug: nehmen Sie mehr Ansichten auf und lösen Sie nochmals.
redo = Wiederholen
redone = Wiederholt.
solve-title = Lösen
solve-what =
    { $used ->
        [one] Eine Ansicht wird benutzt.
       *[other] { $used } Ansichten werden benutzt.
    } Jede wird auch einmal zurückgehalten und aus den anderen vorhergesagt.
solve-start = Lösen
solve-again = Nochmals lösen
solve-running = Wird gelöst
solve-cancel = Abbrechen
solve-done = Gelöst.
solve-failed = Es ließ sich nicht lösen:
solve-cancelled = Abgebrochen. Alle Ansichten sind noch da.
solved-rms = Restfehler, rms
solved-heldout = Zurückgehalten, rms
solved-sigma = Ein Punkt im Messraum
solved-moved = Punkte verschoben gegen die Kalibrierung davor um
solved-report = Bericht (neues Fenster)
activate = Diese Kalibrierung benutzen
activate-title = Diese Kalibrierung benutzen?
activate-what = Sie wird eine eigene Freigabe. Was auch schiefgeht, die alte bleibt; zurück geht es mit einem Schritt in der Liste der Freigaben.
activate-note = Warum (für alle, die es später ansehen)
activated = In Gebrauch, als Freigabe { $number }.

## Prüfen
check-title = Prüfen
check-what = Halten Sie eine Tafel vor beide Kameras, ruhig und ganz im Bild. Ein frisches Bildpaar sagt, ob die Kalibrierung noch gilt.
check-no-rig = Es gibt noch keine Kalibrierung zu prüfen.
check-other = Eine andere Tafel
check-now = Jetzt prüfen
check-running = Es wird gemessen …
check-take = Nehmen Sie die Zelle, um zu prüfen: ihre Kameras werden gebraucht.
check-proof = Eine Tafel, deren mm ebenso falsch sind wie beim Kalibrieren, sieht richtig aus. Am besten ist eine andere Tafel, oder eine mit dem Messschieber gemessene.
check-rows = Zeilen beider Bilder
check-rows-now = { $now } px auseinander, gut ist höchstens { $limit } px
check-px = { $limit } px
check-diagonal = Diagonale der Tafel
check-length-now = { $error } % (dieses Bildpaar: ± { $spread } %), gut ist höchstens ± { $limit } %
check-length-mm = gemessen { $measured } mm, wahr { $truth } mm
check-percent = { $limit } %
checked-last = Letzte Prüfung
checked-never = Noch nicht geprüft.
checked-before = Das war eine andere Kalibrierung als die jetzige: prüfen Sie nochmals.
checked-ok = Die Kalibrierung gilt.
checked-not-ok = Die Kalibrierung gilt nicht mehr.
checked-undecided = Dieses Bildpaar kann es nicht sagen.
remedy-unseen = Halten Sie die ganze Tafel vor beide Kameras, ohne Glanz, und prüfen Sie nochmals. Ist es die Tafel, die oben gewählt ist?
remedy-undecided = Die Tafel ist in diesen Bildern zu klein oder unscharf: bringen Sie sie näher oder nehmen Sie eine größere, und prüfen Sie nochmals.
remedy-rows = Die Kameras haben sich gegeneinander bewegt, oder ein Objektiv. Ziehen Sie fest, was lose ist, und kalibrieren Sie neu.
remedy-length = Die Zeilen stimmen, die Längen nicht. Messen Sie zuerst die Felder der Tafel: stimmen die mm oben? Wenn ja, kalibrieren Sie neu.

## Die virtuelle Bühne von edged demo --stage
stage-title = Virtuelle Bühne: Ihre Hände in dieser Vorführung
stage-what = Diese Kameras sind virtuell. Hier tun Sie, was in einer echten Zelle die Hände tun.
stage-show-board = Tafel halten
stage-show-part = Teil hinlegen
stage-show-nothing = Nichts
stage-hand = Tafel an den gestrichelten Ort bringen
stage-wave-left = Vor der linken Kamera winken
stage-wave-right = Vor der rechten Kamera winken
stage-ring-left = Ring des linken Objektivs
stage-ring-right = Ring des rechten Objektivs
stage-ring = { $turn } einer Vierteldrehung

## System
releases-title = Freigaben
releases-what = Jede Freigabe ist die Zelle, wie sie in Gebrauch ging. Zurück geht es mit ihrer Kalibrierung und ihren Kameras; Aufträge und Einstellungen bleiben.
releases-none = Noch keine: die erste entsteht, wenn eine Kalibrierung benutzt wird.
release = Freigabe { $number }
release-active = in Gebrauch
release-was = war in Gebrauch
release-back = Wieder benutzen
release-back-to = Freigabe { $number } wieder benutzen
release-back-done = Freigabe { $number } ist in Gebrauch.
release-ask-title = Freigabe { $number } wieder benutzen?
release-ask = Die Zelle lädt sie nach dem laufenden Zyklus. Geht etwas schief, bleibt die jetzige.
release-reason = Warum (für alle, die es später ansehen)
role-viewer = viewer: sieht zu
role-operator = operator: prüft und beendet das Einrichten
role-engineer = engineer: richtet ein
users-title = Personen
users-what = Alle haben einen eigenen Namen und ein eigenes Passwort: das Protokoll sagt, wer was getan hat.
user-new = Eine neue Person
user-name = Name
user-role = Rolle
user-role-of = Rolle von { $name }
user-password = Erstes Passwort, mindestens { $least } Zeichen
user-add = Hinzufügen
user-added = { $name } darf herein.
user-remove = Entfernen
user-remove-name = { $name } entfernen
user-remove-what = Die Anmeldungen enden sofort. Was getan wurde, bleibt im Protokoll.
audit-title = Protokoll
audit-whole = { $count } Taten; die Kette hält: nichts wurde geändert oder weggelassen.
audit-broken = Die Kette hält nicht:
audit-time = Wann
audit-user = Wer
audit-what = Was
audit-outcome = Ausgang
audit-reason = Warum
audit-records = Neueste Taten
